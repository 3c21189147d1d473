"""How ranges err with and without line of sight: curves fitted to labelled recordings.

    python examples/hanyang_errors.py Static_measurements.tar.gz --out FOLDER

The archive is that of the Hanyang University data set; its folders say LOS or NLOS, the height
of the anchor (the tag was at 1 m), and the files the horizontal distance. Writes the curves by
name (``curves.toml``) and a figure. Lines that were cut short are left out and counted.
"""

import argparse
import csv
import io
import re
import tarfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kedge.calibration.error_curve_files import write_curves
from kedge.calibration.error_curves import Curve, choose_curve
from kedge.calibration.obstacles import separation
from kedge.reports import style

TAG_HEIGHT = 1.0  # m
NAME = re.compile(r"(LOS|NLOS)/height_([\d.]+)cm/([\d.]+)m\.csv$")


class Static(NamedTuple):
    """One range of a tag at rest, in m and dBm."""

    label: str
    """LOS or NLOS."""
    horizontal: float
    """Distance in plan."""
    true: float
    error: float
    power: float
    first_path: float


def read_static(archive: Path) -> list[Static]:
    """The ranges of the archive; lines that were cut short are left out and counted."""
    rows: list[Static] = []
    short = 0
    with tarfile.open(archive) as files:
        for member in files:
            match = NAME.search(member.name)
            handle = files.extractfile(member) if match else None
            if match is None or handle is None:
                continue
            far = float(match[3])
            true = float(np.hypot(far, float(match[2]) / 100 - TAG_HEIGHT))
            text = io.StringIO(handle.read().decode())
            for row in csv.DictReader(text):
                cells = [row[key] for key in ("Distance", "RSSI(dBm)", "RSSI_fp(dBm)")]
                if not all(cells):
                    short += 1
                    continue
                length, power, first = map(float, cells)
                rows.append(Static(match[1], far, true, length - true, power, first))
    print(f"{short} lines without a distance or a power were left out")
    return rows


def read_errors(archive: Path) -> dict[str, np.ndarray]:
    """By label, one row a range: true distance, error, power less first-path power (dB)."""
    rows = read_static(archive)
    return {
        label: np.array([
            (row.true, row.error, row.power - row.first_path)
            for row in rows if row.label == label
        ])
        for label in ("LOS", "NLOS")
    }  # fmt: skip


def main() -> None:
    """Fit, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("archive", type=Path)
    parser.add_argument("--out", type=Path, default=Path("hanyang-errors"))
    given = parser.parse_args()
    errors = read_errors(given.archive)
    # The bias that grows with the distance is the radio's; it is taken from all ranges alike.
    clear = errors["LOS"]
    slope, offset = np.polyfit(clear[:, 0], clear[:, 1], 1)
    print(
        f"{len(clear)} ranges in line of sight: {offset:+.3f} m, {1000 * slope:+.1f} mm a metre"
    )
    curves: dict[str, Curve] = {}
    left = {}
    for label, table in errors.items():
        rest = table[:, 1] - offset - slope * table[:, 0]
        left[label] = rest[np.abs(rest) < 1.0]
        few = np.random.default_rng(0).choice(left[label], 4000, replace=False)
        curves[label] = choose_curve(few)[0]
        print(
            f"{label}: {len(table)} ranges, median {np.median(rest):+.3f} m, best by AIC "
            f"{curves[label].family}: {curves[label].mean:+.3f} +- {curves[label].std:.3f} m"
        )
    gap = np.concatenate([table[:, 2] for table in errors.values()])
    blocked = np.repeat([False, True], [len(table) for table in errors.values()])
    area = separation(gap, blocked)
    print(f"power less first-path power tells them apart with an AUC of {area:.2f}")
    given.out.mkdir(parents=True, exist_ok=True)
    write_curves(given.out / "curves.toml", curves)
    draw(left, curves, given.out / "errors.png")


@style.styled
def draw(errors: dict[str, np.ndarray], curves: dict[str, Curve], path: Path) -> None:
    """Histograms as densities, with the curves."""
    ax = style.subplots(1, 1, 3.2)[0, 0]
    grid = np.linspace(-0.6, 0.8, 500)
    for number, (label, values) in enumerate(errors.items(), 1):
        color = style.color(f"filter-{number}")
        ax.hist(values, bins=120, range=(-0.6, 0.8), density=True, color=color, alpha=0.3)
        ax.plot(grid, curves[label].density(grid), color=color)
        ax.lines[-1].set_label(f"{label}, {curves[label].family}")
    ax.set(xlabel="range error less the radio's own bias (m)", ylabel="density (1/m)")
    ax.set(xlim=(-0.6, 0.8))
    ax.legend()
    style.save_png(ax.figure, path)


if __name__ == "__main__":
    main()
