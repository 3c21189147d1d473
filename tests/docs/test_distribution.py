"""The distribution: its name, and that it asks for nothing that it does not use."""

import ast
import re
import tomllib
from functools import cache
from importlib.metadata import Distribution, distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
# The name "kedge" on the package index is another project's: whoever installs that, or extras
# of it, runs a stranger's code.
FOREIGN = re.compile(r"(?<![\w.-])kedge\[\w|pip install [^\n]*?(?<![\w./-])kedge(?![\w./-])")
FOLDERS = ("src", "docs", "examples", "benchmarks", ".ci")
TEXTS = {".py", ".md", ".html", ".j2", ".toml", ".txt", ".pyi", ".css", ".cff", "", ".ipynb"}


def texts() -> list[Path]:
    """Whatever a user may read: sources with their messages, pages, settings."""
    files = [path for path in ROOT.iterdir() if path.is_file()]
    for folder in FOLDERS:
        files += [p for p in (ROOT / folder).rglob("*") if "__pycache__" not in p.parts]
    return [path for path in files if path.is_file() and path.suffix in TEXTS]


@pytest.mark.parametrize(
    ("line", "foreign"),
    [
        ("pip install kedge", True),
        ("pip install 'kedge[studio]'", True),
        ('all = ["kedge[studio,native]"]', True),
        ("pip install -U 'kedge==1.0'", True),
        ("pip install 'kedge-nav[studio]'", False),
        ("pip install '.[studio]' && kedge list", True),
        ("pip install dist/kedge_nav-0.1.0-py3-none-any.whl", False),
    ],
)
def test_the_pattern_knows_the_foreign_name(line, foreign):
    assert bool(FOREIGN.search(line)) == foreign


def test_nothing_tells_a_user_to_install_the_other_project():
    foreign = {
        f"{path.relative_to(ROOT)}: {match.group()}"
        for path in texts()
        for match in FOREIGN.finditer(path.read_text(errors="replace"))
    }
    assert foreign == set()
    assert len(texts()) > 300


def test_the_name_is_free_and_extras_that_name_the_distribution_name_it_so():
    assert PROJECT["name"] == "kedge-nav"
    named = [name(need) for extra in EXTRAS.values() for need in extra]
    assert "kedge-nav" in named
    assert "kedge" not in named
    pins = re.findall(r"^([\w.-]+)==", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert not {"kedge", "kedge-nav"} & set(pins)


def name(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")


@cache
def installed() -> dict[str, Distribution]:
    return {name(dist.metadata["Name"]): dist for dist in distributions()}


def modules_and_programs(need: str) -> tuple[set[str], set[str]]:
    """What a distribution brings: the names that one imports, and those that one runs."""
    if need not in installed():
        pytest.skip(f"{need} is not installed")
    dist = installed()[need]
    tops = {path.parts[0].removesuffix(".py") for path in dist.files or ()}
    runs = {e.name for e in dist.entry_points if e.group == "console_scripts"}
    runs |= {p.name for p in dist.files or () if "bin" in p.parts}
    return {top for top in tops if top.isidentifier()}, runs


@cache
def used(folder: str) -> set[str]:
    """Modules that a folder's Python files import, or name in a string to do so."""
    names = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module or "")
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                names.add(node.value if len(node.value) < 40 else "")
    return {each.split(".")[0] for each in names}


# What others load by its own name: a plug-in of pytest, the back end that pip builds with.
BY_NAME = {"pytest-xdist": "-n $(JOBS)"}


@pytest.mark.parametrize(
    ("need", "folders"),
    [(need, ("src",)) for need in PROJECT["dependencies"]]
    + [
        (
            need,
            ("src", "tests", "benchmarks", "docs")
            if extra in {"dev", "rivals"}
            else ("src", "docs"),
        )
        for extra, needs in EXTRAS.items()
        for need in needs
        if name(need) != "kedge-nav"
    ],
)
def test_each_dependency_is_used(need, folders):
    need = name(need)
    modules, programs = modules_and_programs(need)
    recipes = (ROOT / "Makefile").read_text()
    if need in BY_NAME:
        assert BY_NAME[need] in recipes
        return
    runs = any(re.search(rf"\$\(BIN\)/{re.escape(p)}\b", recipes) for p in programs)
    assert runs or (modules | programs) & set().union(*map(used, folders)), (
        f"nothing uses {need}: drop it"
    )
