"""Open-loop eigenvalues of an underwater hull, and its linear model at the steps of a computer.

    python examples/underwater_modes.py [COEFFICIENTS] [--speed M/S] [--step S]

COEFFICIENTS is a shipped set or a file: remus100-adjusted (the default), remus100-derived,
torpedo-1m, my/hull.toml. The hull is linearised about straight and level travel with its fins
at rest; the step is that of a zero-order hold (commands are held over it). Prints what a pilot
has to hold together, and the matrices F and G of x' = F x + G u.
"""

import argparse

import numpy as np

from kedge.numerics.exponential import held_inputs
from kedge.vehicles.underwater.coefficient_files import as_coefficients
from kedge.vehicles.underwater.hydrodynamics import cruise, linearised, modes

STATES = ("u", "v", "w", "p", "q", "r", "roll", "pitch")
COMMANDS = ("thrust", "torque", "rudder", "stern")


def main() -> None:
    """Print eigenvalues and matrices."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("coefficients", nargs="?", default="remus100-adjusted")
    parser.add_argument("--speed", type=float)
    parser.add_argument("--step", type=float, default=0.1)
    options = parser.parse_args()
    hull = as_coefficients(options.coefficients)
    speed = cruise(hull) if options.speed is None else options.speed
    print(f"{options.coefficients} at {speed:.4f} m/s; eigenvalues in 1/s:")
    for value in sorted(modes(hull, speed), key=lambda mode: mode.real):
        swing = f" {value.imag:+.4f}i" if value.imag else ""
        said = "  grows by itself" if value.real > 1e-9 else ""
        print(f"  {value.real:+9.4f}{swing}{said}")
    F, G = (np.asarray(part) for part in held_inputs(*linearised(hull, speed), options.step))
    for name, matrix, columns in (("F", F, STATES), ("G", G, COMMANDS)):
        print(
            f"\n{name} of a step of {options.step:g} s" + "".join(f"{c:>10s}" for c in columns)
        )
        for row, label in zip(matrix, STATES, strict=True):
            print(f"{label:>{len(name) + 16}s}" + "".join(f"{x:10.5f}" for x in row))


if __name__ == "__main__":
    main()
