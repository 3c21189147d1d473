"""Products of units, as covariances have them."""

import pytest

from kedge.core.errors import DataError
from kedge.formats.units import product_of, unit_of

DEG = 0.017453292519943295


@pytest.mark.parametrize(
    ("text", "unit", "factor"),
    [
        ("mm^2", "m^2", 1e-6),
        ("cm^2", "m^2", 1e-4),
        ("(rad/s)^2", "rad^2/s^2", 1.0),
        ("(deg/s)^2", "rad^2/s^2", DEG**2),
        ("deg^2/s^2", "rad^2/s^2", DEG**2),
        ("m^2/s^4", "m^2/s^4", 1.0),
        ("g^2", "m^2/s^4", 9.80665**2),
        ("m*deg", "m*rad", DEG),
        ("deg*m", "m*rad", DEG),
        ("m²/s²", "m^2/s^2", 1.0),
        ("mm/ms", "m/s", 1.0),
        ("m/m", "1", 1.0),
    ],
)
def test_products(text, unit, factor):
    assert unit_of(text) == (unit, pytest.approx(factor, rel=1e-14))


@pytest.mark.parametrize(
    "text", ["", "furlong", "m^", "(m", "m)", "m//s", "m^2^2", "^2", 2000 * "("]
)
def test_no_units(text):
    with pytest.raises(DataError, match="no unit called"):
        unit_of(text)


def test_the_unit_of_a_covariance_has_one_spelling():
    assert product_of("rad", "m") == product_of("m", "rad") == unit_of("m rad")[0]
    assert product_of("rad/s", "rad/s") == unit_of("(rad/s)^2")[0]
