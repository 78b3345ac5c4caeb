"""Execution of proved plans on a machine, over a link, with guards that stop it safely."""
