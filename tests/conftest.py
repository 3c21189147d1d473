"""Settings and fixtures of every test: 64-bit floats, no silent broadcasting, fixed seeds."""

import gc
import os
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

# Arguments and results of every function of kedge are checked at each call, shapes too. But
# not those of the second compiler: it makes millions of calls, and each would take three times
# as long.
SOURCE = Path(__file__).parents[1] / "src" / "kedge"
install_import_hook(
    [
        f"kedge.{path.stem}"
        for path in SOURCE.iterdir()
        if not path.name.startswith("__") and path.name != "compiler"
    ],
    "beartype.beartype",
)

# What several rooms' tests use.
pytest_plugins = ["fixtures.commands", "fixtures.pages"]

# In the environment, so that the programs that tests start have them too.
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / "build" / "jax-cache")
)
# Most of a test's time would go into compiling. These options cut it to a quarter. Golden
# tests and those on recorded data compute for long: they run with XLA_FLAGS empty, and so test
# what XLA optimises as for users. A name that XLA does not know ends the process: versions
# after the pinned one go without.
if jax.__version_info__ < (0, 11):
    os.environ.setdefault(
        "XLA_FLAGS",
        "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 "
        "--xla_llvm_disable_expensive_passes=true",
    )

os.environ.setdefault(
    # Without links: the cache follows none.
    "KEDGE_NATIVE_CACHE",
    str((Path(__file__).parents[1] / "build" / "native-cache").resolve()),
)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

settings.register_profile(
    "kedge",
    derandomize=True,
    deadline=None,
    max_examples=20,
    # The `key` fixture is the same in every example, and compiling is slow once.
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.load_profile("kedge")


# One test, or one file, a line: what takes long although it is not marked. `make slow-list`
# writes it anew from measured times.
LISTED = Path(__file__).with_name("slow.txt")
LONG = {"call": 1.5, "setup": 3.0}  # seconds of CPU; what is set up serves several tests
# Always tried: what a newcomer does first, and the contract of every member of a family.
CONTRACTS = tuple(
    f"tests/contracts/test_{family}.py" for family in ("filters", "sensors", "vehicles")
)
KEPT = (
    "test_documents.py::test_code_blocks_run[README.md]",
    "test_documents.py::test_code_blocks_run[docs/how-to/add-a-vehicle.md]",
    "test_commands.py::test_estimate_leaves_what_it_promises",
    "test_study.py::test_it_prints_scores_beside_what_was_published",
)


def kept(nodeid: str) -> bool:
    return nodeid.endswith(KEPT) or nodeid.startswith(CONTRACTS)


def pytest_addoption(parser: pytest.Parser):
    parser.addoption("--list-slow", action="store_true", help=f"write {LISTED.name}")


def pytest_configure(config: pytest.Config):
    if config.getoption("--list-slow"):
        config.pluginmanager.register(Clock())
        if not hasattr(config, "workerinput"):
            config.pluginmanager.register(Times())


class Clock:
    """Adds to a report the CPU time of its phase, which no other program lengthens much."""

    def pytest_runtestloop(self):
        self.last = sum(os.times()[:4])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self):
        report, now = (yield), sum(os.times()[:4])
        report.cpu, self.last = now - self.last, now
        return report


class Times:
    """Notes which tests take long. If setting up takes long, the others of its file would."""

    def __init__(self):
        self.long: set[str] = set()

    def pytest_runtest_logreport(self, report: pytest.TestReport):
        if report.cpu > LONG.get(report.when or "", np.inf) and not kept(report.nodeid):
            file = report.nodeid.split("::")[0]
            self.long.add(file if report.when == "setup" else report.nodeid)

    def pytest_sessionfinish(self):
        whole = {one for one in self.long if "::" not in one}
        lines = whole | {one for one in self.long if one.split("::")[0] not in whole}
        LISTED.write_text("".join(f"{line}\n" for line in sorted(lines)))


def pytest_collection_finish():
    """Tracing makes millions of short-lived objects: a quarter of it was looking for cycles."""
    gc.freeze()
    gc.set_threshold(100_000, 20, 50)


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]):
    listed = set(LISTED.read_text().splitlines() if LISTED.exists() else ())
    if config.getoption("--list-slow"):
        listed = set()
    for item in items:
        if isinstance(item, pytest.Function):
            parameters = item.callspec.params if hasattr(item, "callspec") else {}
            if "data" in item.fixturenames and "data" not in parameters:
                item.add_marker("data")
        if "golden" in item.path.relative_to(config.rootpath).parts:
            item.add_marker("golden")
        names = {item.nodeid, item.nodeid.split("::")[0]}
        if names & listed and not kept(item.nodeid):
            item.add_marker("slow")
        if item.get_closest_marker("gpu") and jax.default_backend() != "gpu":
            item.add_marker(pytest.mark.skip(reason="JAX finds no GPU"))


@pytest.fixture
def key():
    return jax.random.key(0)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of recorded data sets; a test that asks for it is marked `data`."""
    folder = os.environ.get("KEDGE_DATA")
    if not folder:
        pytest.skip("KEDGE_DATA is not set: no recorded data sets")
    if not Path(folder).is_dir():
        pytest.skip(f"KEDGE_DATA is {folder}, which is no folder")
    return Path(folder)
