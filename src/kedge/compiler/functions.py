"""Elementary functions as arithmetic, so that all runs in a register are done at once.

Each is accurate to about one unit in the last place, as libm is. What has no formula here is a
call of the C library for each run.
"""

import math

import numpy as np

from kedge.compiler.algebra import Algebra, value_of
from kedge.compiler.graph import Node

HALF_PI = 1.5707963267948966, 6.123233995736766e-17, -1.4973849048591833e-33
"""pi / 2 as a sum of doubles."""
FAR = 1e5
"""Radians from which on the reduction by three terms is left to libm."""
SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
LOGARITHM = (
    6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01,
    2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01,
    1.479819860511658591e-01,
)  # fmt: skip
LOG2_PARTS = 6.93147180369123816490e-01, 1.90821492927058770002e-10
ARCTANGENT = (
    (-8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1,
     -1.228866684490136173410e2, -6.485021904942025371773e1),
    (1.0, 2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2,
     4.853903996359136964868e2, 1.945506571482613964425e2),
)  # fmt: skip


class Functions(Algebra):
    """Algebra with elementary functions. Formulas are for doubles; floats are widened.

    Source: Sun Microsystems, "fdlibm", 1993, files k_sin.c, k_cos.c, e_log.c (the minimax
    coefficients); S. Moshier, "Methods and Programs for Mathematical Functions", 1989
    (arctangent).
    """

    def call(self, name: str, *args: Node) -> Node:
        """A function of the C library."""
        kind = args[0].kind
        wide = [self.convert(arg, "f8") for arg in args]
        return self.convert(self.graph.make("call", "f8", wide, name), kind)

    def polynomial(self, coefficients: tuple[float, ...], x: Node) -> Node:
        """Horner's scheme, lowest power first."""
        value = self.const(coefficients[-1], x.kind)
        for coefficient in reversed(coefficients[:-1]):
            value = self.fma(value, x, self.const(coefficient, x.kind))
        return value

    def sine(self, a: Node, quarter: int = 0) -> Node:
        """Sine of an angle, or with ``quarter=1`` cosine."""
        name = "cos" if quarter else "sin"
        if a.is_const:
            known = value_of(a)
            return self.const(
                getattr(math, name)(known) if math.isfinite(known) else math.nan, a.kind
            )
        x = self.convert(a, "f8")

        def number(value: float) -> Node:
            return self.const(value, "f8")

        turns = self.unary("even", self.mul(x, number(2 / math.pi)))
        reduced = x
        for part in HALF_PI:
            reduced = self.fma(turns, number(-part), reduced)
        square = self.mul(reduced, reduced)
        sine = self.fma(self.mul(reduced, square), self.polynomial(SINE, square), reduced)
        half = self.mul(number(0.5), square)
        high = self.sub(number(1.0), half)
        # What 1 - x^2 / 2 lost to rounding is given back.
        lost = self.sub(self.sub(number(1.0), high), half)
        tail = self.fma(self.mul(square, square), self.polynomial(COSINE, square), lost)
        cosine = self.add(high, tail)
        # Quadrants by floats: integers would have to be converted lane by lane.
        turns = self.add(turns, number(float(quarter))) if quarter else turns
        fourth = self.mul(turns, number(0.25))
        quadrant = self.mul(number(4.0), self.sub(fourth, self.unary("floor", fourth)))
        odd = self.both(
            "or",
            self.compare("eq", quadrant, number(1.0)),
            self.compare("eq", quadrant, number(3.0)),
        )
        value = self.select(odd, cosine, sine)
        value = self.select(self.compare("ge", quadrant, number(2.0)), self.neg(value), value)
        near = self.compare("lt", self.absolute(x), number(FAR))
        return self.convert(self._rarely(near, value, name, x), a.kind)

    def exponential(self, a: Node) -> Node:
        """Natural exponential."""
        return self.call("exp", a)

    def logarithm(self, a: Node) -> Node:
        """Natural logarithm; numbers that are not normal go to libm."""
        if a.is_const:
            with np.errstate(all="ignore"):
                return self.const(np.log(np.float64(value_of(a))), a.kind)
        x = self.convert(a, "f8")

        def number(value: float) -> Node:
            return self.const(value, "f8")

        def whole(value: int) -> Node:
            return self.const(value, "i8")

        bits = self.graph.make("bitcast", "i8", (x,))
        # The exponent is counted from sqrt(1/2), so that the mantissa is close to 1.
        counted = self.sub(bits, whole(0x3FE6A09E667F3BCD))
        power = self.graph.make("shift_signed", "i8", (counted, whole(52)))
        shifted = self.graph.make("shift_left", "i8", (power, whole(52)))
        mantissa = self.graph.make("bitcast", "f8", (self.sub(bits, shifted),))
        # An integer below 2^51 as a float, by its bits: vectors have no conversion.
        biased = self.add(power, whole(0x4338000000000000))
        k = self.sub(self.graph.make("bitcast", "f8", (biased,)), number(6755399441055744.0))
        f = self.sub(mantissa, number(1.0))
        s = self.div(f, self.add(number(2.0), f))
        z = self.mul(s, s)
        series = self.mul(z, self.polynomial(LOGARITHM, z))
        half = self.mul(self.mul(number(0.5), f), f)
        inner = self.fma(s, self.add(half, series), self.mul(k, number(LOG2_PARTS[1])))
        value = self.sub(self.mul(k, number(LOG2_PARTS[0])), self.sub(self.sub(half, inner), f))
        normal = self.both(
            "and",
            self.compare("ge", x, number(2.2250738585072014e-308)),
            self.compare("lt", x, number(math.inf)),
        )
        return self.convert(self._rarely(normal, value, "log", x), a.kind)

    def arctangent(self, y: Node, x: Node) -> Node:
        """Angle of a point of the plane."""
        if y.is_const and x.is_const:
            return self.const(math.atan2(value_of(y), value_of(x)), y.kind)
        kind, y, x = y.kind, self.convert(y, "f8"), self.convert(x, "f8")

        def number(value: float) -> Node:
            return self.const(value, "f8")

        up, right = self.absolute(y), self.absolute(x)
        steep = self.compare("gt", up, right)
        small = self.select(steep, right, up)
        large = self.select(steep, up, right)
        # atan t = pi / 4 + atan (t - 1) / (t + 1) for t > 0.66, without dividing twice.
        beyond = self.compare("gt", small, self.mul(number(0.66), large))
        above = self.select(beyond, self.sub(small, large), small)
        below = self.select(beyond, self.add(small, large), large)
        t = self.div(above, below)
        z = self.mul(t, t)
        numerator, denominator = (
            self.polynomial(tuple(reversed(part)), z) for part in ARCTANGENT
        )
        angle = self.fma(t, self.mul(z, self.div(numerator, denominator)), t)

        def less_than_quarter(value: Node) -> Node:
            return self.add(self.sub(number(HALF_PI[0]), value), number(HALF_PI[1]))

        eighth = self.add(self.add(angle, number(HALF_PI[1] / 2)), number(HALF_PI[0] / 2))
        angle = self.select(beyond, eighth, angle)
        angle = self.select(steep, less_than_quarter(angle), angle)
        behind = self.compare("lt", x, number(0.0))
        about = self.add(self.sub(number(2 * HALF_PI[0]), angle), number(2 * HALF_PI[1]))
        angle = self.select(behind, about, angle)
        angle = self.graph.make("copysign", "f8", (angle, y))
        # Zeros, infinities and NaN have rules of their own.
        regular = self.both(
            "and",
            self.compare("gt", large, number(0.0)),
            self.compare("lt", large, number(math.inf)),
        )
        return self.convert(self._rarely(regular, angle, "atan2", y, x), kind)

    def _rarely(self, usual: Node, value: Node, name: str, *args: Node) -> Node:
        """``value`` where ``usual``; where not for some run, libm is asked, for these runs."""
        if usual.is_const and value_of(usual):
            return value
        index = self.graph.make("all", "i8", (usual,), None)
        index.varying = False

        def ask() -> list[Node | None]:
            return [self.select(usual, value, self.graph.make("call", "f8", args, name))]

        (merged,) = self.graph.branch(index, [ask, lambda: [value]])
        return value if merged is None else merged
