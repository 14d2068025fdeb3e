from __future__ import annotations

import os
import subprocess
import sys

from kr270_milling.live.ros.environment import GUARD, PARENT, PROFILES, RANGE, child_environment, this_host_only


def test_shipped_profile_is_used_where_the_user_has_none():
    added = this_host_only({})
    assert added[PROFILES[0]].endswith("fastdds.xml") and os.path.isfile(added[PROFILES[0]])
    assert this_host_only({RANGE: "LOCALHOST"})[PROFILES[0]] == added[PROFILES[0]]


def test_profile_of_the_user_wins_and_discovery_stays_on_the_host():
    for name in PROFILES:
        assert this_host_only({name: "/my.xml"}) == {RANGE: "LOCALHOST"}
    assert this_host_only({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}) == {RANGE: "LOCALHOST"}


def test_user_who_opens_the_discovery_range_is_left_alone():
    assert this_host_only({RANGE: "SUBNET"}) == {}


def test_child_finds_its_own_libraries_and_knows_its_parent(monkeypatch):
    monkeypatch.setenv(GUARD, "1")
    environment = child_environment()
    assert GUARD not in environment
    assert environment[PARENT] == str(os.getpid())


def test_missing_ros_is_one_sentence_with_the_command_that_installs_it(tmp_path):
    hide = "import importlib.util as u; find = u.find_spec; u.find_spec = lambda n: None if n == 'rclpy' else find(n);"
    code = hide + "from kr270_milling.cli import main; raise SystemExit(main(['run', 'paper.yaml']))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 2
    assert "kr270_milling[ros]" in ran.stderr and ran.stderr.count("\n") == 1
