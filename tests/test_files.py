"""Result files are whole; what is not is told apart, cleared or named."""

import numpy as np
import pytest
from dead_runs import die_writing
from kfenv.agents.files import clear_partial, is_free, read_arrays, read_json, written_whole


def test_what_a_dead_run_had_begun_is_ignored_and_cleared_but_not_a_living_ones(tmp_path):
    folder = tmp_path / "scores"
    folder.mkdir()
    die_writing(folder / "fixed.npz")
    [left] = folder.iterdir()
    assert left.read_bytes() == b"half" and is_free(folder)
    with written_whole(folder / "mine.json") as file:
        clear_partial(tmp_path)
        assert not left.exists()
        file.write(b"{}")
    assert [path.name for path in folder.iterdir()] == ["mine.json"] and not is_free(folder)


def test_a_folder_is_free_if_nothing_in_it_matters(tmp_path):
    assert is_free(tmp_path) and is_free(tmp_path / "none")
    (tmp_path / ".lock").touch()
    assert is_free(tmp_path)
    (tmp_path / "thesis.partial").touch()
    assert not is_free(tmp_path) and not is_free(tmp_path / "thesis.partial")


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b"null", b"\xff{}"])
def test_damaged_json_is_named_with_the_remedy(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.json is damaged: pray\."):
        read_json(path, dict, "pray")


def test_damaged_arrays_are_named_with_the_remedy(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, one=np.arange(100.0), two=np.array([{}]))
    whole = path.read_bytes()
    np.testing.assert_array_equal(read_arrays(path, ["one"], "")["one"], np.arange(100.0))
    for name in ("two", "three"):  # no arrays of numbers, not there
        with pytest.raises(ValueError, match=r"a\.npz is damaged .*: pray\."):
            read_arrays(path, [name], "pray")
    flipped = whole[:200] + bytes([whole[200] ^ 1]) + whole[201:]
    for content in (b"", whole[:50], whole[:-30], flipped, b"PK\x03\x04", b"text"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.npz is damaged .*: pray\."):
            read_arrays(path, ["one"], "pray")
