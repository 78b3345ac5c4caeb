"""What every room stands on: checked arrays, compiled code, progress of long work, and wording."""
