"""ifor: the paper's baseline, as a matcher."""

from toolkit_ifor.matcher import Ifor, IforConfig

__all__ = ["Ifor", "IforConfig"]
