from threadline.face import compare as compare
from threadline.face import compile as compile
from threadline.face import fastest as fastest
from threadline.face import judge as judge
from threadline.face import load_machine as load_machine
from threadline.face import prove as prove
from threadline.face import retime as retime
from threadline.face import shaper as shaper

__version__: str
__all__ = ["compare", "compile", "fastest", "judge", "load_machine", "prove", "retime", "shaper"]
