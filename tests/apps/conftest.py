"""A small recorded log on disk, and a way to run commands in this process."""

import csv
import sys

import numpy as np
import pytest

from kedge.apps import cli

RIG = """
[vehicle]
model = "unicycle"
parameters = { speed_noise = 0.1, yaw_rate_noise = 0.02 }

[control]
source = "odometry"

[sensors.camera]
model = "landmarks"
map = "posts"
target = "post"
parameters = { range_std = 0.1, bearing_std = 0.02 }
gate = 0.01

[prior]
from_truth = ["position", "heading"]
std = { position = 0.1, heading = 0.05 }

[output]
rate = 5.0
"""

LOG = """
title = "a circle in a yard"
truth = "truth"

[sources.odometry]
columns = { speed = "m/s", yaw_rate = "deg/s" }

[sources.camera]
target = "post"
columns = { range = "m", bearing = "rad" }

[sources.truth]
columns = { position_x = "m", position_y = "m", heading = "rad" }

[maps.posts]
ids = ["a", "b"]
values = { position_x = [8.0, -4.0], position_y = [1.0, 6.0] }
columns = { position_x = "m", position_y = "m" }
"""


def write(path, header, rows):
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([header, *rows])


@pytest.fixture
def site(tmp_path):
    """``rig.toml`` and a log folder: 20 s on a circle, two posts in view in turn."""
    folder = tmp_path / "log"
    folder.mkdir()
    (tmp_path / "rig.toml").write_text(RIG)
    (folder / "log.toml").write_text(LOG)
    random = np.random.default_rng(7)
    time = np.round(np.arange(0, 20.01, 0.1), 3)
    turn = 0.2
    heading = turn * time
    x, y = 5 * np.sin(heading), 5 - 5 * np.cos(heading)
    write(
        folder / "odometry.csv",
        ["time", "speed", "yaw_rate"],
        # What the wheels say is 5 % too fast: dead reckoning drifts.
        [[t, 1.05, np.rad2deg(turn)] for t in time],
    )
    write(
        folder / "truth.csv",
        ["time", "position_x", "position_y", "heading"],
        [
            [t, a, b, (c + np.pi) % (2 * np.pi) - np.pi]
            for t, a, b, c in zip(time, x, y, heading, strict=True)
        ],
    )
    posts = {"a": (8.0, 1.0), "b": (-4.0, 6.0)}
    rows = []
    for i in range(5, len(time), 5):
        name = "ab"[i // 5 % 2]
        dx, dy = posts[name][0] - x[i], posts[name][1] - y[i]
        bearing = np.arctan2(dy, dx) - heading[i] + random.normal(0, 0.02)
        rows.append(
            [
                time[i],
                name,
                np.hypot(dx, dy) + random.normal(0, 0.1),
                (bearing + np.pi) % (2 * np.pi) - np.pi,
            ]
        )
    write(folder / "camera.csv", ["time", "post", "range", "bearing"], rows)
    return tmp_path


@pytest.fixture
def kedge(monkeypatch, capsys):
    """Run a command in this process: exit code, standard output, standard error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["kedge", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capsys.readouterr()
        return end.value.code, out, err

    return run
