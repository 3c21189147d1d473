"""Cross-check with an independent tool: the programs evo_ape and evo_rpe.

They are run as programs and never imported: their licence is the GPL.
"""

import io
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.evaluation.trajectory import (
    Trajectory,
    absolute_pose_error,
    align,
    relative_pose_error,
)
from kedge.formats.tum import write_tum

AGREEMENT = 1e-6  # m and rad


def program(name):
    found = shutil.which(name) or shutil.which(name, path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip(f"{name} is not installed: pip install evo")
    return found


def figures(folder, name, *options):
    """Errors, stamps and statistics that a program saves for truth.tum and estimate.tum."""
    results = folder / "results.zip"
    results.unlink(missing_ok=True)
    # The program keeps its settings in the home folder; a test leaves none behind.
    home = {"HOME": str(folder), "USERPROFILE": str(folder), "MPLBACKEND": "Agg"}
    subprocess.run(
        [
            *(program(name), "tum", "truth.tum", "estimate.tum", *options),
            *("--no_warnings", "--save_results", results.name),
        ],
        check=True,
        capture_output=True,
        cwd=folder,
        env=os.environ | home,
        timeout=120,
    )
    with zipfile.ZipFile(results) as archive:
        return (
            np.load(io.BytesIO(archive.read("error_array.npy"))),
            np.load(io.BytesIO(archive.read("timestamps.npy"))),
            json.loads(archive.read("stats.json")),
        )


def agree(error, relation, theirs):
    values = {"trans_part": error.translations, "angle_rad": error.rotations}[relation]
    summary = {"trans_part": error.translation, "angle_rad": error.rotation}[relation]
    errors, stamps, statistics = theirs
    assert len(errors) > 5
    np.testing.assert_allclose(values, errors, rtol=0, atol=AGREEMENT)
    # APE keeps the stamps of all poses, RPE those of the later pose of each pair.
    np.testing.assert_allclose(error.time, stamps, rtol=0, atol=AGREEMENT)
    for name, value in summary._asdict().items():
        assert abs(value - statistics[name]) < AGREEMENT, name


@pytest.fixture(scope="module")
def spatial(tmp_path_factory):
    """A dive with turns, and an estimate of another scale, in another frame, with noise."""
    rng, count = np.random.default_rng(0), 200
    nanoseconds = np.arange(count) * 100_000_000
    phase = np.linspace(0, 4 * np.pi, count)
    where = np.stack([10 * np.cos(phase), 10 * np.sin(phase), -phase], axis=1)
    turns = Rotation.from_euler("ZYX", np.stack([phase, 0.2 * np.sin(phase), 0 * phase], 1))
    other = Rotation.from_rotvec([0.4, -0.3, 1.2])
    moved = 1.1 * other.apply(where) + [3.0, -2.0, 1.0] + 0.2 * rng.normal(size=(count, 3))
    turned = other * turns * Rotation.from_rotvec(0.1 * rng.normal(size=(count, 3)))
    return stored(tmp_path_factory.mktemp("spatial"), nanoseconds, moved, turned, where, turns)


def stored(folder, nanoseconds, moved, turned, where, turns):
    pair = []
    for name, position, rotation in (("estimate", moved, turned), ("truth", where, turns)):
        orientation = rotation
        if isinstance(rotation, Rotation):
            orientation = rotation.as_quat()[:, [3, 0, 1, 2]]
        write_tum(folder / f"{name}.tum", nanoseconds, position, orientation)
        pair.append(Trajectory(nanoseconds / 1e9, position, orientation))
    return folder, *pair


# Each starts a program that takes seconds; the fast tests run one of each kind.
long = pytest.mark.slow

ALIGNMENTS = {"none": [], "origin": ["--align_origin"], "rigid": ["-a"], "similarity": ["-as"]}


@pytest.mark.parametrize(
    ("kind", "relation"),
    [
        pytest.param("none", "trans_part", marks=long),
        pytest.param("none", "angle_rad", marks=long),
        pytest.param("origin", "trans_part", marks=long),
        pytest.param("rigid", "trans_part", marks=long),
        ("rigid", "angle_rad"),
        ("similarity", "trans_part"),
    ],
)
def test_absolute_errors_are_those_of_evo_ape(spatial, kind, relation):
    folder, estimate, truth = spatial
    error = absolute_pose_error(align(estimate, truth, kind), truth)
    agree(error, relation, figures(folder, "evo_ape", "-r", relation, *ALIGNMENTS[kind]))


@pytest.mark.parametrize(
    ("delta", "unit", "pairs_from", "relation"),
    [
        pytest.param(1, "frames", "estimate", "trans_part", marks=long),
        (7, "frames", "estimate", "angle_rad"),
        pytest.param(3.0, "metres", "estimate", "trans_part", marks=long),
        (3.0, "metres", "truth", "trans_part"),
        pytest.param(3.0, "metres", "truth", "angle_rad", marks=long),
    ],
)
def test_relative_errors_are_those_of_evo_rpe(spatial, delta, unit, pairs_from, relation):
    folder, estimate, truth = spatial
    error = relative_pose_error(estimate, truth, delta, unit, pairs_from=pairs_from)
    options = ["-r", relation, "-d", str(delta), "-u", unit[0]]
    options += ["--pairs_from_reference"] if pairs_from == "truth" else []
    agree(error, relation, figures(folder, "evo_rpe", *options))


@long
def test_planar_errors_are_those_of_evo(tmp_path):
    rng, count = np.random.default_rng(1), 150
    nanoseconds = np.arange(count) * 50_000_000
    heading = np.linspace(0, 3 * np.pi, count)
    where = np.cumsum(0.1 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    moved = where + np.cumsum(0.02 * rng.normal(size=(count, 2)), axis=0)
    turned = heading + 0.05 * rng.normal(size=count)
    folder, estimate, truth = stored(tmp_path, nanoseconds, moved, turned, where, heading)

    error = absolute_pose_error(align(estimate, truth, "rigid"), truth)
    agree(error, "angle_rad", figures(folder, "evo_ape", "-r", "angle_rad", "-a"))
    error = relative_pose_error(estimate, truth, 0.5, "metres")
    agree(error, "trans_part", figures(folder, "evo_rpe", "-d", "0.5", "-u", "m"))
