"""Names of files that commands leave."""

from kedge.apps.output import file_name


def test_names_of_files():
    assert file_name("robust(extended):loss=huber") == "robust_extended__loss=huber"
    long = [file_name("ä" * 300 + end) for end in "ab"]
    assert len(set(long)) == 2
    assert all(len(name.encode()) <= 100 for name in long)
