"""From measurements to the numbers of a machine file, with the certainty of each number."""
