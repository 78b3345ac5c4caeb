"""The reader of windings: from mandrel and layers to fibre, pattern and the path of the eye."""

from threadline.jobs.winding.job import own_product, read_winding

__all__ = ["own_product", "read_winding"]
