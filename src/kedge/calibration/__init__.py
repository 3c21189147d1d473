"""What instruments are off by, found from recordings: ranges, radios, IMUs, Doppler logs."""

from kedge.core import lazy

__getattr__, __dir__, __all__ = lazy.attach(__name__, __file__)
