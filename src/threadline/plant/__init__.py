"""Machine -> equations of motion, and what they tell: modes, margins, responses."""
