"""The executor of proved plans, the links to machines, and what keeps both safe."""
