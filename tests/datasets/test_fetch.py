"""Downloads: what is whole is kept, what is not is thrown away."""

import hashlib
import zipfile

import pooch
import pytest

from kedge.core.errors import DataError
from kedge.datasets import fetch as module
from kedge.datasets.fetch import DATASETS, fetch, log_of, verify

CONTENT = {"a.dat": b"1 2 3\n", "b.dat": b"4 5 6\n"}
KNOWN = {name: hashlib.sha256(data).hexdigest() for name, data in CONTENT.items()}


@pytest.fixture
def server(tmp_path, monkeypatch):
    """What is downloaded, as a file that a test writes; and the cache."""
    archive, cache = tmp_path / "cache" / "datasets" / "download", tmp_path / "cache"
    archive.parent.mkdir(parents=True)
    monkeypatch.delenv("KEDGE_DATA", raising=False)
    monkeypatch.setattr(module, "user_cache_path", lambda name: cache)
    monkeypatch.setattr(module, "checksums", lambda name: KNOWN)
    monkeypatch.setattr(pooch, "retrieve", lambda *rest, **more: str(archive))
    return archive


def packed(archive, content):
    with zipfile.ZipFile(archive, "w") as bundle:
        for name, data in content.items():
            bundle.writestr(name, data)


def spoilt(archive):
    data = bytearray(archive.read_bytes())
    data[35] ^= 0xFF
    archive.write_bytes(data)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda a: a.write_text("<html>not found</html>"), "no whole zip archive"),
        (lambda a: packed(a, {"a.dat": CONTENT["a.dat"]}), "b.dat is missing"),
        (lambda a: packed(a, CONTENT | {"b.dat": b"other"}), "b.dat has SHA-256"),
        (lambda a: (packed(a, CONTENT), spoilt(a)), "no whole zip archive"),
        (lambda a: (packed(a, CONTENT), a.write_bytes(a.read_bytes()[:90])), "no whole zip"),
    ],
    ids=["a page", "a file missing", "another file", "a byte", "cut off"],
)
def test_what_is_not_the_data_set_is_thrown_away(server, make, message):
    make(server)
    with pytest.raises(DataError, match=message):
        fetch("mrclam")
    assert list(server.parent.iterdir()) == []
    packed(server, CONTENT)
    assert fetch("mrclam") == server.parent / DATASETS["mrclam"].folder


def test_only_files_that_are_known_come_out_and_only_into_their_folder(server):
    packed(server, {"../../evil": b"!", "/tmp/evil": b"!", "other": b"!"} | {
        f"../set/{name}": data for name, data in CONTENT.items()
    })  # fmt: skip
    folder = fetch("mrclam")
    verify("mrclam", folder)
    written = sorted(f for f in server.parents[2].rglob("*") if f.is_file())
    assert written == [folder / "a.dat", folder / "b.dat"]


def test_a_data_set_s_name_stands_for_its_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("KEDGE_DATA", str(tmp_path))
    folder = tmp_path / DATASETS["mrclam"].folder
    with pytest.raises(DataError, match="kedge datasets fetch mrclam"):
        log_of("mrclam")
    folder.mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert log_of("mrclam") == str(folder)
    assert log_of("mrclam#3") == f"{folder}#3"
    assert log_of("some/log#2") == "some/log#2"
    (tmp_path / "elsewhere" / "mrclam").mkdir()
    assert log_of("mrclam") == "mrclam"
