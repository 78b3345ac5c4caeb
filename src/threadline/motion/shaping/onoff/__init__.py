"""On/off motion: the fastest rest-to-rest commands of a machine that rings."""
