"""Files for controllers, read back by code that did not write them, and compared with the plan."""
