"""Execution of proved plans over links to machines, guards that stop runs, and the kept runs."""
