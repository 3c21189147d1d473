"""Layer 2: one sensor a file; a file dropped in here is found without being named.

``sensors.Gnss`` is the class that is registered as "gnss".
"""

from kedge.core import lazy, registry

__getattr__, __dir__, __all__ = lazy.attach(__name__, __file__, registry.sensors)
