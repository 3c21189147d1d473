"""Where something is, from one epoch of ranges: no memory, no motion model."""

from kedge.core import lazy

__getattr__, __dir__, __all__ = lazy.attach(__name__, __file__)
