"""The fastest motion along a path within limits: a convex problem in the square of the speed."""
