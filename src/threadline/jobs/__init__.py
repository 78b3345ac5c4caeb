"""Jobs and the readers that make them, one per file format."""
