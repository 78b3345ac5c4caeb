"""What was run: a folder for each run, and an index of all of them."""
