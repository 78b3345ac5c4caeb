"""Proof of a job: options, plan, kinds of work, pipeline and proof file."""
