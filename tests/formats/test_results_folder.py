"""What kedge wrote is replaced in one step; all else in a folder stays, whatever happens."""

import contextlib
import json
import os
import subprocess
import sys

import pytest

from kedge.core.errors import DataError
from kedge.formats import atomic, results_folder
from kedge.formats.atomic import replace_file
from kedge.formats.results_folder import fresh_folder
from kedge.formats.results_folder import results_folder as open_results


def write(folder, kind="estimate", **files):
    with open_results(folder, kind) as draft:
        for name, text in files.items():
            path = draft / name.replace("_", ".")
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)


def tree(folder):
    """Every file below a folder with its text, the mark and nothing hidden apart."""
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "kedge.json"
    }


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "deep" / "out"
    write(folder, summary_json="1", table_csv="a")
    return folder


def test_with_force_what_was_changed_since_is_replaced_and_what_is_foreign_is_not(out):
    (out / "summary.json").write_text("by hand")
    (out / "notes").write_text("mine")
    with pytest.raises(DataError, match="was changed since kedge wrote it"):
        write(out, summary_json="2")
    with pytest.raises(ZeroDivisionError), open_results(out, "estimate", force=True):
        _ = 1 / 0
    assert tree(out) == {"summary.json": "by hand", "table.csv": "a", "notes": "mine"}
    with open_results(out, "estimate", force=True) as draft:
        (draft / "summary.json").write_text("2")
    assert tree(out) == {"summary.json": "2", "notes": "mine"}
    with (
        pytest.raises(DataError, match="was not written by kedge"),
        open_results(out, "estimate", force=True) as draft,
    ):
        (draft / "notes").write_text("2")
    with (
        pytest.raises(DataError, match="'kedge locate' does not replace"),
        open_results(out, "locate", force=True),
    ):
        pass
    assert tree(out) == {"summary.json": "2", "notes": "mine"}


def test_files_that_are_no_longer_written_go(out):
    write(out, summary_json="2")
    assert tree(out.parent) == {"out/summary.json": "2"}
    assert json.loads((out / "kedge.json").read_text())["kind"] == "estimate"


@pytest.mark.parametrize("exchanges", [True, False])
def test_what_is_not_kedges_stays(out, exchanges, monkeypatch):
    if not exchanges:
        monkeypatch.setattr(results_folder, "put", lambda *_: None)
    (out / "study" / "chunks").mkdir(parents=True)
    (out / "study" / "chunks" / "000001.npz").write_text("mine")
    (out / "notes").write_text("mine")
    (out / "empty").mkdir()
    inode = (out / "notes").stat().st_ino
    write(out, summary_json="2", more_csv="b")
    assert tree(out.parent) == {
        "out/summary.json": "2",
        "out/more.csv": "b",
        "out/notes": "mine",
        "out/study/chunks/000001.npz": "mine",
    }
    assert (out / "empty").is_dir()
    assert (out / "notes").stat().st_ino == inode


def test_a_foreign_file_with_a_new_name_is_in_the_way(out):
    (out / "more.csv").write_text("mine")
    before = tree(out)
    with pytest.raises(DataError, match=r"more\.csv: was not written by kedge"):
        write(out, summary_json="2", more_csv="b")
    assert tree(out.parent) == {f"out/{name}": text for name, text in before.items()}


@pytest.mark.parametrize("change", ["text", "link", "folder"])
def test_what_the_user_changed_is_not_replaced(out, change, tmp_path):
    table = out / "table.csv"
    table.unlink()
    if change == "text":
        table.write_text("mine")
    elif change == "link":  # the same text, elsewhere
        (tmp_path / "elsewhere").write_text("a")
        table.symlink_to(tmp_path / "elsewhere")
    else:
        table.mkdir()
    with pytest.raises(DataError, match=r"table\.csv: was changed since kedge wrote it"):
        write(out, summary_json="2")
    assert (out / "summary.json").read_text() == "1"
    assert os.path.lexists(table)


def test_what_the_user_deleted_is_no_obstacle(out):
    (out / "table.csv").unlink()
    write(out, summary_json="2")
    assert tree(out) == {"summary.json": "2"}


def test_folders_of_others_are_refused(out, tmp_path):
    with pytest.raises(
        DataError, match="holds what 'kedge estimate' wrote, which 'kedge tune'"
    ):
        write(out, kind="tune", tune_json="1")
    other = tmp_path / "project"
    other.mkdir()
    (other / "summary.json").write_text("{}")
    with pytest.raises(DataError, match="not empty and not kedge's"):
        write(other, summary_json="2")
    assert tree(other) == {"summary.json": "{}"}
    with pytest.raises(DataError, match="not empty"), fresh_folder(out):
        pass


@pytest.mark.parametrize(
    "mark",
    [
        "", "[]", "{}", "\0", '{"kind": 3, "files": {}}', '{"kind": "estimate", "files": 3}',
        '{"kind": "estimate", "files": {"a": 3}}', '{"kind": "estimate", "files": {"": "3"}}',
        '{"kind": "estimate", "files": {"../x": "3"}}', "[" * 100_000,
        '{"kind": "estimate", "files": {"/x": "3"}}',
    ],
)  # fmt: skip
def test_a_mark_that_is_none(out, mark):
    (out / "kedge.json").write_text(mark)
    before = tree(out)
    with pytest.raises(DataError, match=r"kedge\.json: is no list of kedge's files"):
        write(out, summary_json="2")
    assert tree(out) == before


def test_a_link_is_written_to_its_target(out, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(out)
    write(link, summary_json="2")
    assert link.is_symlink()
    assert tree(out) == {"summary.json": "2"}
    (tmp_path / "dangling").symlink_to(tmp_path / "new")
    write(tmp_path / "dangling", summary_json="3")
    assert tree(tmp_path / "new") == {"summary.json": "3"}


def test_where_somebody_stands_the_folder_stays_the_same(out, monkeypatch):
    monkeypatch.chdir(out)
    inode = out.stat().st_ino
    write(".", summary_json="2")
    assert out.stat().st_ino == inode
    assert tree(out) == {"summary.json": "2"}


def test_a_failure_leaves_all_as_it_was(out, tmp_path):
    with contextlib.suppress(ZeroDivisionError), open_results(out, "estimate") as draft:
        (draft / "summary.json").write_text("2")
        raise ZeroDivisionError
    assert tree(out.parent) == {"out/summary.json": "1", "out/table.csv": "a"}
    below = tmp_path / "a" / "b"
    with contextlib.suppress(ZeroDivisionError), open_results(below, "estimate"):
        raise ZeroDivisionError
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", ["n" * 300, "n" * 250])
def test_long_names(tmp_path, name):
    if len(name) > 255:
        with pytest.raises(DataError, match="cannot be written: File name too long"):
            write(tmp_path / name, summary_json="1")
    else:
        write(tmp_path / name, summary_json="1")
        write(tmp_path / name, summary_json="2")
        assert tree(tmp_path) == {f"{name}/summary.json": "2"}


def test_a_second_writer_is_refused(out):
    with open_results(out, "estimate") as draft:
        (draft / "summary.json").write_text("2")
        for kind in ("estimate", "tune"):
            with pytest.raises(DataError, match="another kedge is writing there"):
                write(out, kind=kind, summary_json="3")
    assert tree(out) == {"summary.json": "2"}


KILLED = """
import os, shutil, sys
from pathlib import Path
from kedge.formats import atomic, results_folder

def counted(call):
    def run(*arguments, **more):
        global remaining
        remaining -= 1
        if remaining < 0:
            os._exit(9)
        return call(*arguments, **more)
    return run

def work(folder):
    for name in ("rename", "replace", "unlink", "rmdir", "mkdir"):
        setattr(os, name, counted(getattr(os, name)))
        setattr(Path, name, counted(getattr(Path, name)))
    shutil.rmtree = counted(shutil.rmtree)
    os.fsync = counted(os.fsync)
    atomic.exchange = counted(atomic.exchange)
    with results_folder.results_folder(folder, "estimate") as draft:
        for name in ("summary.json", "fresh.csv"):
            (draft / name).write_text("2")
        (draft / "same.csv").write_text("s")
        (draft / "figures").mkdir()
        (draft / "figures" / "b.svg").write_text("2")

for remaining, folder in enumerate(sys.argv[1:]):
    child = os.fork()
    if child == 0:
        work(folder)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.parametrize("foreign", [False, True])
def test_a_kill_at_each_step(tmp_path, foreign):
    """Whatever the step: the old result or the new one is whole after the next run's begin."""
    old = {"summary.json": "1", "old.csv": "1", "figures/a.svg": "1", "same.csv": "s"}
    new = {"summary.json": "2", "fresh.csv": "2", "figures/b.svg": "2", "same.csv": "s"}
    mine = {"notes": "mine", "figures/mine": "mine"} if foreign else {}
    folders = [tmp_path / str(step) / "out" for step in range(60)]
    for out in folders:
        with open_results(out, "estimate") as draft:
            (draft / "figures").mkdir()
            for name, text in old.items():
                (draft / name).write_text(text)
        for name, text in mine.items():
            (out / name).write_text(text)
    command = [sys.executable, "-c", KILLED, *map(str, folders)]
    codes = subprocess.run(command, stdout=-1, text=True, check=True).stdout.split()
    steps = codes.count("9")
    assert codes == ["9"] * steps + ["0"] * (len(codes) - steps)
    assert 10 < steps < len(codes)
    seen = []
    for out in folders:
        assert mine.items() <= tree(out).items()  # never away, not even for a moment
        with contextlib.suppress(ZeroDivisionError), open_results(out, "estimate"):
            raise ZeroDivisionError
        files = tree(out.parent)
        assert files in [{f"out/{k}": v for k, v in (r | mine).items()} for r in (old, new)]
        assert sorted(p.name for p in out.parent.iterdir()) == ["out"]
        seen.append(files["out/summary.json"])
    assert seen == sorted(seen)
    assert set(seen) == {"1", "2"}


def test_files_are_replaced_whole_and_what_a_kill_left_is_swept(tmp_path):
    path = tmp_path / ("n" * 250)
    draft = atomic.draft_name(path, tmp_path)
    draft.write_text("half")
    replace_file(path, b"1")
    link = tmp_path / "link"
    link.symlink_to(path)
    replace_file(link, b"2")
    assert link.is_symlink()
    assert sorted(tmp_path.iterdir()) == [link, path]
    assert path.read_bytes() == b"2"
    with pytest.raises(DataError, match="cannot be written"):
        replace_file(tmp_path / "nowhere" / "file", b"1")


def test_the_lock_ends_with_its_process(out):
    program = (
        "import os, sys\nfrom kedge.formats.results_folder import results_folder\n"
        "with results_folder(sys.argv[1], 'estimate') as d:\n"
        "    print('in', flush=True); sys.stdin.read()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(out)], stdin=-1, stdout=-1, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "in\n"
    with pytest.raises(DataError, match="another kedge is writing there"):
        write(out, summary_json="2")
    process.kill()
    process.communicate()
    write(out, summary_json="2")
    assert tree(out.parent) == {"out/summary.json": "2"}
