"""Layer 4: worlds in which the truth is known.

``simulation.Circle`` is the route that is registered as "circle"; worlds and faults likewise.
"""

from kedge.core import lazy, registry

__getattr__, __dir__, __all__ = lazy.attach(
    __name__, __file__, registry.worlds, registry.routes, registry.faults
)
