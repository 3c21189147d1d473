"""``kedge config schema summary`` describes what the commands leave; of fixes: test_locate."""

import json

import jsonschema
import pytest

from fixtures.studies import buoy_text


@pytest.fixture
def validate(kedge):
    """Run a command, and hold the summary that it leaves against the schema."""
    code, out, err = kedge("config", "schema", "summary")
    assert code == 0, err
    schema = json.loads(out)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)

    def run(folder, *arguments):
        code, printed, err = kedge(*arguments, "--out", folder, "--no-report", "--json")
        assert code == 0, err
        summary = json.loads((folder / "summary.json").read_text())
        assert summary == json.loads(printed)
        validator.validate(summary)
        for key in ("filters", "warnings", "digest"):
            assert not validator.is_valid({k: v for k, v in summary.items() if k != key}), key
        name, scores = next(iter(summary["filters"].items()))
        filters = summary["filters"] | {name: scores | {"strange": 1.0}}
        assert not validator.is_valid(summary | {"filters": filters})
        return summary

    return run


def test_of_logs(site, validate):
    filters = "dead-reckoning,extended,particle:count=50,extended+smoother"
    case = site / "rig.toml", site / "log"
    summary = validate(site / "compare", "compare", *case, "--filters", filters)
    assert set(summary["filters"]) == set(filters.split(","))
    assert "effective_size" in summary["filters"]["particle:count=50"]["health"]
    free = ["--set", "prior.from_truth=[]", "--set", "prior.mean={}"]
    summary = validate(site / "free", "estimate", *case, "--truth", "none", *free)
    assert "rmse" not in summary["filters"]["extended"]


def test_of_studies(tmp_path, validate):
    scenario = tmp_path / "buoy.toml"
    scenario.write_text(
        'errata = ["Table 4"]\n'
        + buoy_text(
            filters=["kalman", "dead-reckoning"],
            after="""
[published]
kalman = { rmse = 0.5, source = "nowhere" }
[windows]
late = [[2.0, 3.0]]
[[expected]]
score = "kalman.rmse.position"
between = [0.0, 9.0]
[[quoted]]
score = "extended.rmse.position"
value = 1.0
source = "Table 1"
[[claims]]
text = "readings make it worse"
source = "a letter"
test = "kalman.score > dead-reckoning.score"
""",
        )
    )
    summary = validate(tmp_path / "out", "study", scenario, "--runs", "2")
    assert summary["quoted"][0]["here"] is None
    assert summary["claims"][0]["means"] == ""
    one = validate(tmp_path / "one", "study", scenario, "--runs", "1", "--filters", "kalman")
    assert one["filters"]["kalman"]["score_ci"] == [None, None]
