"""The operator's panel: a web server, and below it the process that owns the machine."""
