"""What is written stays below --out, appears whole, replaces no link's target and has the permissions of the umask."""

from __future__ import annotations

import os
import stat
import threading

import pytest
from hostile import SHORT, ask, contents, refused, settings
from recording_samples import record

pytest.importorskip("geometry_msgs")
SECRET = b"not to be touched"
WRITERS = {
    "simulate": ("simulate", "paper.yaml", *settings(*SHORT), "--out", "{out}"),
    "compensate": ("compensate", "paper.yaml", *settings(*SHORT), "--method=linear", "--no-verdict", "--out", "{out}"),
    "demo": ("demo", "--plain", "--out", "{out}"),
    "export": ("export", "{recording}", "--csv", "{out}"),
    "revise": ("replay", "{passed}", "--compensate", "--out", "{out}"),
    "report": ("report", "{passed}", "--out", "{out}"),
    "recover": ("recover", "{recording}", "--out", "{out}"),
}
PLACES = ("file", "file/below", "/proc/nowhere", "/dev/null/x", "/dev/null", "a\0b", "n" * 300)
QUICK = [name for name in WRITERS if name != "demo"]  # it has no option to be short


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """One of every topic, and one of a whole pass."""
    import pass_recording

    directory = tmp_path_factory.mktemp("recordings")
    record(directory / "topics", 5)
    pass_recording.write(directory / "pass", pass_recording.one_pass())
    return {"recording": str(directory / "topics"), "passed": str(directory / "pass")}


def words(name: str, recordings, out) -> list[str]:
    return [word.format(out=out, **recordings) for word in WRITERS[name]]


def written(name: str, recordings, out) -> list[str]:
    """The files of a run that goes well, by their names below ``out``."""
    answer = ask(*words(name, recordings, out))
    assert answer.code in (0, 1) and answer.err == "", answer
    actual = [key for key, value in contents(out).items() if value != "dir"]
    assert actual and all(contents(out)[key] for key in actual)
    return actual


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("place", PLACES)
def test_a_place_that_cannot_be_written_into_is_told(name, place, recordings, tmp_path):
    (tmp_path / "file").write_bytes(SECRET)
    out = place if place.startswith("/") else f"{tmp_path}/{place}"
    refused(*words(name, recordings, out))
    assert contents(tmp_path) == {"file": SECRET}


@pytest.mark.parametrize("name", QUICK)
def test_links_among_the_files_are_never_followed(name, recordings, tmp_path):
    """Each file that a command writes is, the next time, a link to a file elsewhere."""
    names = written(name, recordings, tmp_path / "first")
    out, victim = tmp_path / "out", tmp_path / "victim"
    victim.write_bytes(SECRET)
    for file in names:
        (out / file).parent.mkdir(parents=True, exist_ok=True)
        (out / file).symlink_to(victim)
        (out / file).with_name(f".{os.path.basename(file)}.{os.getpid()}.part").symlink_to(victim)
    answer = ask(*words(name, recordings, out))
    assert victim.read_bytes() == SECRET
    if answer.code != 2:
        assert not any((out / file).is_symlink() for file in names)
    else:  # a recording is never written over anything
        assert name == "recover" and answer.err.count("\n") == 1


@pytest.mark.parametrize("name", ["compensate"])
def test_a_linked_folder_below_the_output_is_refused(name, recordings, tmp_path):
    names = written(name, recordings, tmp_path / "first")
    folders = {os.path.dirname(file) for file in names} - {""}
    assert folders
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir(), elsewhere.mkdir()
    for folder in folders:
        (out / folder).symlink_to(elsewhere, target_is_directory=True)
    assert "link" in refused(*words(name, recordings, out))
    assert list(elsewhere.iterdir()) == []


@pytest.mark.parametrize("name", QUICK)
def test_permissions_are_those_of_the_umask(name, recordings, tmp_path):
    before = os.umask(0o027)
    try:
        names = written(name, recordings, tmp_path / "out")
    finally:
        os.umask(before)
    for file in names:
        assert stat.S_IMODE((tmp_path / "out" / file).stat().st_mode) == 0o640, file
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o750


@pytest.mark.parametrize("name", ["simulate", "compensate", "revise", "report", "export"])
def test_a_reader_never_sees_half_a_file(name, recordings, tmp_path):
    """While a command writes over its files again and again, each file is always as long as the whole one."""
    out = tmp_path / "out"
    names = written(name, recordings, out)
    sizes = {file: set() for file in names}
    done = threading.Event()

    def watch():
        while not done.is_set():
            for file in names:
                sizes[file].add(os.stat(out / file).st_size)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        for _ in range(3):
            ask(*words(name, recordings, out))
    finally:
        done.set()
        watcher.join()
    for file, seen in sizes.items():
        assert min(seen) > 0.9 * max(seen), f"{file}: {seen}"


@pytest.mark.parametrize("name", [n for n in QUICK if n != "recover"])
def test_other_files_in_the_output_stay(name, recordings, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_bytes(SECRET)
    written(name, recordings, out)
    assert (out / "mine.txt").read_bytes() == SECRET
    assert not [file for file in contents(tmp_path) if ".part" in file]
