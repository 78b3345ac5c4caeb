"""Makes light, flexible machines move fast and land still, and proves it."""

__version__ = "0.1.0"
