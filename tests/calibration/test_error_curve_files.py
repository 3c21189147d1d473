"""Error curves are read back as they were written, and a file that is wrong is refused."""

import numpy as np
import pytest

from kedge.calibration.error_curve_files import read_curves, write_curves
from kedge.calibration.error_curves import fit_curve
from kedge.core.errors import ConfigError


def test_curves_come_back(tmp_path):
    rng = np.random.default_rng(16)
    curves = {
        "a person": fit_curve(0.1 + rng.exponential(0.3, 200), "exponential"),
        "A1": fit_curve(rng.normal(0.1, 0.2, 200)),
    }
    write_curves(tmp_path / "curves.toml", curves)
    assert read_curves(tmp_path / "curves.toml") == curves


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"normal"', '"normaal"', "no family of error curves called 'normaal'.*'normal'"),
        ("samples = 200", "sample = 200", "curves.A1.sample"),
        ("mean = ", "mean = 1", "expected those of the parameters"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path, old, new, message):
    path = tmp_path / "curves.toml"
    write_curves(path, {"A1": fit_curve(np.random.default_rng(17).normal(0.1, 0.2, 200))})
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message):
        read_curves(path)
