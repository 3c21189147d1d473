"""A made-up run in the format of the Snapir: what is turned, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.core.errors import DataError, UnknownName
from kedge.formats.readers import read_log

DVL = "Time [s],DVL X [m/s],DVL Y [m/s],DVL Z [m/s]\n"
GT = (
    "Time [s],Longitude [rad],Latitude [rad],Altitude [m],V North [m/s],V East [m/s],"
    "V Down [m/s],Roll [rad],Pitch [rad],Yaw [rad]\n"
)
HALF_PI = np.pi / 2


@pytest.fixture
def folder(tmp_path):
    """Run 4, one folder down: eastwards at 2 m/s, 10 m deep, nose to the east."""
    below = tmp_path / "Trajectory4"
    below.mkdir()
    rows = [f"{t}.0,2.0,0.1,-0.05\n" for t in range(4)]
    (below / "DVL_trajectory4.csv").write_text(DVL + "".join(rows))
    east = 2.0 / 6_378_137.0  # rad of longitude in a second, on the equator
    rows = [f"{t}.0,{0.5 + east * t},0.0,0.0,0.0,2.0,0.0,0.1,0.2,{HALF_PI}\n" for t in range(4)]
    (below / "GT_trajectory4.csv").write_text(GT + "".join(rows))
    return tmp_path


def test_a_run_comes_out_in_east_north_up_and_forward_left_up(folder):
    raw = read_log(str(folder), "auv_akit_snapir")
    dvl, truth = raw.tables["dvl"].columns, raw.truth

    np.testing.assert_allclose([dvl[f"velocity_body_{a}"][0] for a in "xyz"], [2, -0.1, 0.05])
    assert truth is not None
    np.testing.assert_allclose(truth.columns["position_x"], [0, 2, 4, 6], atol=1e-9)
    np.testing.assert_allclose(truth.columns["position_y"], 0, atol=1e-9)
    turn = Rotation.from_quat([truth.columns[f"attitude_{a}"][0] for a in "xyzw"])
    # Yaw from north is 90 degrees: east. Nose up and right side down stay what they are.
    heading, pitch, roll = turn.as_euler("ZYX")
    np.testing.assert_allclose([heading, -pitch, roll], [0, 0.2, 0.1], atol=1e-12)
    east = turn.inv().apply([2.0, 0, 0])
    found = [truth.columns[f"velocity_body_{a}"][0] for a in "xyz"]
    np.testing.assert_allclose(found, east, atol=1e-12)
    assert "misses its own position by 0.00 m, 0.00 % of 6 m" in raw.notes[0]
    assert len(raw.tables["rates"].stamps) == 31
    np.testing.assert_allclose(raw.tables["rates"].columns["angular_rate_z"], 0, atol=1e-12)


def test_what_is_wrong_is_named(folder):
    with pytest.raises(UnknownName, match="no run called '5'; there are 4"):
        read_log(f"{folder}#5", "auv_akit_snapir")
    file = folder / "Trajectory4" / "GT_trajectory4.csv"
    text = file.read_text()
    file.write_text(text.replace("Yaw", "Heading"))
    with pytest.raises(
        DataError, match=r"GT_trajectory4.csv:1: no column called 'Yaw \[rad\]'"
    ):
        read_log(str(folder), "auv_akit_snapir")
    file.write_text(text.replace("\n2.0,", "\n0.5,"))
    with pytest.raises(DataError, match=r"GT_trajectory4.csv:4: .* time that does not go back"):
        read_log(str(folder), "auv_akit_snapir")
    file.unlink()
    with pytest.raises(DataError, match="expected the reference beside DVL_trajectory4"):
        read_log(str(folder), "auv_akit_snapir")
    (folder / "Trajectory4" / "DVL_trajectory4.csv").unlink()
    with pytest.raises(DataError, match="found no DVL_trajectoryN"):
        read_log(str(folder), "auv_akit_snapir")
