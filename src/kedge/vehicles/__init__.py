"""Layer 2: one vehicle a file; a file dropped in here is found without being named.

``vehicles.Unicycle`` is the class that is registered as "unicycle".
"""

from kedge.core import lazy, registry

__getattr__, __dir__, __all__ = lazy.attach(__name__, __file__, registry.vehicles)
