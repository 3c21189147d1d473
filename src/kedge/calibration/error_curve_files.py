"""Error curves in a TOML file: one for each channel, link or obstacle, by name."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from kedge.calibration.error_curves import FAMILIES, Curve
from kedge.core.registry import unknown
from kedge.formats.atomic import replace_file
from kedge.formats.results import as_toml
from kedge.formats.toml import Strict, read_toml


class CurveConfig(Strict):
    """One curve; numbers in m."""

    family: str
    parameters: dict[str, float]
    std_errors: dict[str, float] = {}
    mean: float
    std: float
    log_likelihood: float
    aic: float
    samples: int

    def validation_errors(self) -> Iterator[str]:
        """An unknown family, a mean or deviation that is not that of the parameters."""
        if self.family not in FAMILIES:
            yield f"family: {unknown('family of error curves', self.family, list(FAMILIES))}"
            return
        try:
            mean, std = FAMILIES[self.family].moments(**self.parameters)
        except TypeError:
            yield f"parameters: found {list(self.parameters)}, which {self.family} has not"
            return
        if abs(mean - self.mean) > 1e-6 or abs(std - self.std) > 1e-6:
            yield (
                f"mean: found {self.mean:g} and std {self.std:g}, expected those of the "
                f"parameters, {mean:g} and {std:g}"
            )


class StoreConfig(Strict):
    """The file."""

    curves: dict[str, CurveConfig]


def write_curves(path: Path, curves: Mapping[str, Curve]) -> None:
    """Write curves by name, so that :func:`read_curves` gives them back."""
    table = {"curves": {name: curve._asdict() for name, curve in curves.items()}}
    for curve in table["curves"].values():
        # TOML would read a NaN; a standard error that is not known is left out.
        known = {k: v for k, v in curve["std_errors"].items() if v == v}
        curve["std_errors"] = known
    replace_file(path, as_toml(table).encode())


def read_curves(path: Path) -> dict[str, Curve]:
    """Read curves by name; standard errors that are not known are NaN.

    Raises:
        ConfigError: the file is missing or wrong; one line for each mistake.
    """
    curves = {}
    for name, spec in read_toml(path, StoreConfig).curves.items():
        fields = spec.model_dump()
        gaps = dict.fromkeys(spec.parameters, float("nan"))
        fields["std_errors"] = gaps | fields["std_errors"]
        curves[name] = Curve(**fields)
    return curves
