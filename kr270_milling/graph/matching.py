"""Who must hear whom before a pass may start; counted at both ends, because each end matches on its own."""

from __future__ import annotations

from kr270_milling.graph.driver import Driver, compatible

__all__ = ["COMPENSATOR", "CUT", "RECORDER", "ROBOT", "unmatched"]

ROBOT, CUT, COMPENSATOR, RECORDER = "compliant_robot", "cutting_process", "trajectory_compensator", "recorder"

#: (publisher, topic) -> subscribers without which a pass is worth nothing
NEEDED = {
    (ROBOT, "tool_pose"): {CUT, COMPENSATOR, RECORDER},
    (ROBOT, "deflection"): {RECORDER},
    (ROBOT, "joint_states"): {RECORDER},
    (ROBOT, "robot_description"): {RECORDER},
    (ROBOT, "clock"): {RECORDER},
    (CUT, "wrench"): {ROBOT, COMPENSATOR, RECORDER},
    (CUT, "workpiece"): {RECORDER},
    (COMPENSATOR, "reference_trajectory"): {ROBOT, CUT, RECORDER},
    (COMPENSATOR, "joint_trajectory"): {RECORDER},
    (COMPENSATOR, "target_path"): {RECORDER},
    (COMPENSATOR, "reference_path"): {RECORDER},
}


def unmatched(driver: Driver, recorded: bool) -> str:
    """What is not matched yet, in a few words; empty when a pass may start.

    recorded: whether the recorder must be there; if not, it must be gone, so that the next one is not mistaken for it.
    """
    for (publisher, topic), subscribers in NEEDED.items():
        name = topic if topic.startswith("/") else driver.name_of(topic)
        wanted = subscribers if recorded else subscribers - {RECORDER}
        problem = _unmatched(driver, name, publisher, wanted, recorded)
        if problem:
            return problem
    return ""


def _unmatched(driver: Driver, topic: str, publisher: str, wanted: set[str], recorded: bool) -> str:
    publishers, subscriptions = driver.ends(topic)
    ours = _of_graph(driver, publishers).get(publisher)
    there = _of_graph(driver, subscriptions)
    if ours is None:
        return f"{publisher} does not publish {topic}"
    if wanted - set(there):
        return f"{topic} is not heard by {', '.join(sorted(wanted - set(there)))}"
    if not recorded and RECORDER in there:
        return f"the last recorder still listens to {topic}"
    expected = sum(compatible(ours, s) for s in subscriptions)
    if _count(driver, publisher, "listeners", topic) != expected:
        return f"{publisher} has not found every listener of {topic}"
    for node in wanted:
        if _count(driver, node, "heard", topic) != sum(compatible(p, there[node]) for p in publishers):
            return f"{node} has not found every publisher of {topic}"
    return ""


def _of_graph(driver: Driver, ends) -> dict[str, object]:
    """The ends that belong to nodes of this namespace, by node."""
    return {end.node_name: end for end in ends if end.node_namespace == driver.namespace}


def _count(driver: Driver, node: str, key: str, topic: str) -> int:
    status = driver.status(node)
    return -1 if status is None else status.counts(key).get(topic, 0)
