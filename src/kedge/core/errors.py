"""Every error that kedge raises on purpose.

* KedgeError
  - ContractError      a vehicle, sensor or filter does not keep its contract
  - UnknownName        no such entry in a registry; the message lists those that exist
  - DataError          a log or a message cannot be used
  - ConfigError        a file cannot be understood; the message says file, line and key

A message names the place (file, line, key or column), what was found and what was expected.
"""


class KedgeError(Exception):
    """Base class. Catch it to catch everything raised on purpose."""


class ContractError(KedgeError):
    """A vehicle, sensor or filter does not keep its contract."""


class UnknownName(KedgeError):
    """A registry has no entry of that name."""


class DataError(KedgeError):
    """A log or a message cannot be used."""


class ConfigError(KedgeError):
    """A file cannot be understood."""
