"""The STL file, read back without the writer's code."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from milled_part import POCKET, small_cell

from kr270_milling.base.errors import InputError
from kr270_milling.cell.jobs import simulate
from kr270_milling.decide.part import machined, write_part, write_stl


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    cell = small_cell(tmp_path_factory.mktemp("stl"), POCKET)
    return machined(cell, cell.target().sample(np.arange(0, cell.target().duration_ns, 500_000)))


def read(path) -> np.ndarray:
    """Corners (m, 3, 3) [mm] and the normals (m, 3) of a binary STL, by its definition: 84 bytes, then 50 each."""
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 80)
    assert len(data) == 84 + 50 * count and not data.startswith(b"solid")
    rows = np.array([struct.unpack_from("<12f", data, 84 + 50 * k) for k in range(count)])
    return rows[:, 3:].reshape(-1, 3, 3), rows[:, :3]


@pytest.fixture(scope="module")
def mesh(cut, tmp_path_factory):
    path = tmp_path_factory.mktemp("file") / "part.stl"
    assert write_stl(path, cut) == (path.stat().st_size - 84) // 50
    return read(path)


def test_every_edge_is_shared_by_two_triangles_that_run_it_in_opposite_directions(mesh):
    corners, _ = mesh
    _, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    number = number.reshape(-1, 3)
    edges = np.concatenate([number[:, [0, 1]], number[:, [1, 2]], number[:, [2, 0]]])
    one_way, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 1
    np.testing.assert_array_equal(one_way, np.unique(edges[:, ::-1], axis=0))


def test_its_volume_is_that_of_the_stock_without_the_chips(cut, mesh):
    corners, _ = mesh
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    size = (cut.stock.max - cut.stock.min) * 1e3
    chips = cut.removed_volume * 1e9
    assert volume == pytest.approx(np.prod(size) - chips, abs=0.01 * chips)
    assert chips > 200


def test_its_box_is_the_stock(cut, mesh):
    corners, _ = mesh
    np.testing.assert_allclose(corners.reshape(-1, 3).min(0), cut.stock.min * 1e3, atol=1e-5)
    np.testing.assert_allclose(corners.reshape(-1, 3).max(0), cut.stock.max * 1e3, atol=1e-5)


def test_its_normals_are_those_of_the_corners_order(mesh):
    corners, normals = mesh
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    np.testing.assert_allclose(np.sum(cross * normals, axis=1), length, rtol=1e-5)
    assert length.min() > 0


def test_nodes_that_are_nearer_give_the_volume_more_exactly(cut, tmp_path):
    wrong = []
    for thinning in (40, 4):
        write_stl(tmp_path / "part.stl", cut, cut.heights(thinning=thinning))
        corners, _ = read(tmp_path / "part.stl")
        volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        wrong.append(abs(volume - np.prod(cut.stock.max - cut.stock.min) * 1e9 + cut.removed_volume * 1e9))
    assert wrong[1] < 0.3 * wrong[0]


def test_the_part_of_a_pass_is_that_of_its_own_map_and_of_another_sweep(tmp_path, monkeypatch):
    cell = small_cell(tmp_path, POCKET, "stock.grid_step_um=100")
    result = simulate(cell).result
    again = machined(cell, result.tool)
    write_stl(tmp_path / "swept.stl", again, again.map_heights())
    monkeypatch.setattr("kr270_milling.decide.part.workpiece.machined", None)  # nothing is swept
    write_part(tmp_path / "part.stl", cell, result)
    assert (tmp_path / "part.stl").read_bytes() == (tmp_path / "swept.stl").read_bytes()


def test_a_large_part_is_written_as_finely_as_the_size_of_the_file_allows(cut, tmp_path, monkeypatch):
    monkeypatch.setattr("kr270_milling.decide.part.workpiece.MOST_TRIANGLES", 20_000)
    assert 10_000 < write_stl(tmp_path / "part.stl", cut) <= 20_000


def test_a_file_that_cannot_be_written_leaves_nothing(cut, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_stl(tmp_path / "missing" / "part.stl", cut)
    (tmp_path / "part.stl").mkdir()
    with pytest.raises(InputError):
        write_stl(tmp_path / "part.stl", cut)
    assert [p.name for p in tmp_path.iterdir()] == ["part.stl"]
