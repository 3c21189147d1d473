"""Layer 2: one filter a file; a file dropped in here is found without being named.

``filters.Extended`` is the class that is registered as "extended", ``filters.GaussHermite``
that of "gauss-hermite".
"""

from kedge.core import lazy, registry

__getattr__, __dir__, __all__ = lazy.attach(__name__, __file__, registry.filters)
