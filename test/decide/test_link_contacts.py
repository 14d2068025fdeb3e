"""Contacts of the links of the arm: each own collision is reported with its depth, and sound programs have none."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.decide.check_arm import link_contacts
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot.kinematics import forward, pose
from kr270_milling.physics.robot.urdf import LINKS, link_capsules


def cell_of(*settings):
    return read_cell(find_file("test_piece.yaml"), settings)


def places_of(cell, joints) -> dict[str, np.ndarray]:
    """Places on the segments of the capsules of each link with their radius, (n, 4), in the workpiece frame."""
    placed, frames = arm_of(cell), forward(cell.arm, cell.mount, joints)
    places: dict[str, list[np.ndarray]] = {name: [] for name in LINKS}
    for link, start, end, radius in link_capsules(cell.arm, cell.mount):
        ends = start + np.linspace(0.0, 1.0, 201)[:, None] * (end - start)
        if 0 < link < 7:
            ends = frames.nodes[link - 1] + ends @ frames.rotations[link - 1].T
        elif link:
            frame = frames.flange if link == 7 else frames.tool
            ends = frame.position + ends @ frame.rotation.T
        inside = (ends - placed.place.position) @ placed.place.rotation
        places[LINKS[link]].append(np.column_stack([inside, np.full(201, radius)]))
    return {name: np.vstack(rows) for name, rows in places.items() if rows}


def contacts_in(cell, run) -> list:
    return link_contacts(arm_of(cell), cell.tool.stick_out, cell.workpiece, cell.stock, run)


@pytest.mark.parametrize("key", ["d1", "a1", "a3", "d6"])
def test_a_link_without_length_has_finite_capsules(key):
    """A capsule that is not a number would be in no contact."""
    cell = cell_of()
    for _, start, end, radius in link_capsules(cell.arm.replace(**{key: 0.0}), cell.mount):
        assert np.isfinite([*start, *end, radius]).all()


def test_boxes_in_the_links_are_found_with_the_depth_of_a_dense_sampling_and_the_others_are_not():
    """Each of 24 boxes begins within or beside the hull of one link at the start; the arm hardly moves."""
    cell, rng, contacts = cell_of("stock.max_mm=[40,40,0]"), np.random.default_rng(3), 0
    places = places_of(cell, arm_of(cell).joints(path_of(cell).target)[0])
    for _ in range(24):
        name = rng.choice(LINKS[2:])
        row = places[name][rng.integers(len(places[name]))]
        way = rng.normal(size=3)
        corner = row[:3] + way / np.linalg.norm(way) * row[3] * rng.uniform(0.5, 1.5)
        low, high = np.sort([corner, corner + np.sign(way) * 0.02], axis=0)
        box = ",".join(f"{1e3 * value:.6f}" for value in [*low, *high])
        results = contacts_in(cell_of(f"workpiece.fixtures_mm=[{box}]"), path_of(cell).target)
        depths = {f.sentence.split(" enters")[0]: f.value for f in results if f.subject == "fixture 1"}
        for link, rows in places.items():
            beyond = np.maximum(low - rows[:, :3], rows[:, :3] - high)
            away = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
            depth = 1e3 * (rows[:, 3] - away).max()
            if link != "the base" and depth > 0.0:  # at other places of the path the contact is deeper
                contacts += 1
                assert depths[link] >= depth - 1.0, (link, box)
    assert contacts >= 18


def test_links_that_meet_in_postures_within_the_limits_of_the_joints_are_found_and_no_others():
    """Postures of a folded arm; the depth is that of a dense sampling, whose places are up to 20 mm apart."""
    cell = cell_of("workpiece.xyz_mm=[0,0,0]", "workpiece.abc_deg=[0,0,0]")
    rng, contacts = np.random.default_rng(5), 0
    chain = {name: min(k, 6) for k, name in enumerate(LINKS)}
    for _ in range(40):
        joints = rng.uniform(np.radians([-90, -146, 130, -90, 60, -90]), np.radians([90, -60, 155, 90, 120, 90]))
        place = pose(cell.arm, cell.mount, joints)
        still = Trajectory(np.array([0, 10**9]), np.tile(place.position, (2, 1)), place.quaternion)
        here = cell.replace(posture_hint=joints, start_joints=np.zeros(0))
        results = [f for f in contacts_in(here, still) if f.subject in chain]
        seen = {(f.sentence.split(" enters")[0], f.subject): f.value for f in results}
        places = places_of(here, arm_of(here).joints(still)[0])
        for (other, rows), (link, base) in itertools.permutations(places.items(), 2):
            if chain[other] - chain[link] >= 3:
                away = np.linalg.norm(rows[::4, None, :3] - base[::4, :3], axis=-1)
                depth = 1e3 * (rows[::4, None, 3] + base[::4, 3] - away).max()
                assert seen.get((other, link), 0.0) == pytest.approx(max(depth, 0.0), abs=2.0)
                contacts += depth > 2.0
    assert contacts >= 10


@pytest.mark.parametrize("name", ["paper.yaml", "test_piece.yaml"])
def test_the_shipped_cells_have_no_contact_of_a_link(name):
    cell = read_cell(find_file(name), ["workpiece.table_z_mm=-20"] if name == "test_piece.yaml" else [])
    assert not contacts_in(cell, path_of(cell).target)
