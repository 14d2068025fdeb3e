"""One trial: a fault at its time, the reaction, and the comparison with the design."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from faults.aftermath import Recorded, read_back
from faults.disturbed import Disturbed, Message
from faults.faults import ENDS, GOES_ON, Fault
from kr270_milling.base.errors import MillingError
from kr270_milling.live.graph.graph import NOT_COMPLETE
from kr270_milling.physics.motion.milling_pass import PassResult

__all__ = ["NAMED_WITHIN", "TOO_LATE", "Trial", "judge_words", "run_trial"]

NAMED_WITHIN = 3.0  # [s] from the fault to a sentence that names the node
TOO_LATE = "the fault came too late: the pass was over"
BEHIND = 1.0  # [s] before the fault that a recording may miss


@dataclass
class Trial:
    """Result of a trial; ``problems`` is empty where the reaction is the designed one."""

    fault: str
    after_s: float  #: from the start of the pass to the fault
    detected_s: float | None = None  #: from the fault to the sentence that names the node
    sentence: str = ""
    reaction: str = ""
    ended_s: float | None = None  #: from the fault to the end of the run, where it ended
    last_message: str = ""  #: then
    lost: int = 0  #: messages that the recording has not, counted
    recording: Recorded | None = None
    orphans: int = 0
    problems: list[str] = field(default_factory=list)


def run_trial(graph: Disturbed, fault: Fault, name: str, after: float, plain: PassResult, again: bool) -> Trial:
    """One pass with the fault in it; again: recompute the recording. The graph is stopped if the fault ends it."""
    trial = Trial(fault.name, after)
    graph.disturb(fault.strike(graph), after)
    try:
        graph.run_pass(name)
        trial.reaction = GOES_ON
    except MillingError as error:
        graph.messages.append(Message(time.monotonic(), str(error)))
        trial.reaction = ENDS
        graph.stop()
    finally:
        graph.end_beside()
    if graph.struck_at is None:
        ended = trial.reaction == ENDS
        trial.problems.append(f"the run ended before the fault: {graph.messages[-1].sentence}" if ended else TOO_LATE)
        return trial
    judge_words(trial, fault, graph)
    _judge_recording(trial, fault, graph, plain, again)
    return trial


def judge_words(trial: Trial, fault: Fault, graph: Disturbed) -> None:
    named = [
        message for message in graph.messages if fault.names_it(message.sentence) and message.at >= graph.struck_at
    ]
    if fault.named and named:
        trial.detected_s, trial.sentence = named[0].at - graph.struck_at, named[0].sentence
    elif graph.messages:
        trial.sentence = graph.messages[0].sentence
    if fault.named and trial.detected_s is None:
        trial.problems.append(f"not named; messages: {[message.sentence for message in graph.messages]}")
    elif fault.named and trial.detected_s > NAMED_WITHIN:
        trial.problems.append(f"reported after {trial.detected_s:.2f} s")
    if trial.reaction == ENDS:
        trial.ended_s, trial.last_message = graph.messages[-1].at - graph.struck_at, graph.messages[-1].sentence
    if trial.reaction != fault.reaction:
        trial.problems.append(f"{trial.reaction}: {graph.messages[-1].sentence if graph.messages else 'no message'}")


def _judge_recording(trial: Trial, fault: Fault, graph: Disturbed, plain: PassResult, again: bool) -> None:
    try:
        struck = graph.struck_wall_ns
        recorded = read_back(graph.recording, plain, struck, struck - round(trial.after_s * 1e9), again)
    except MillingError as error:
        trial.problems.append(f"recording: {error}")
        return
    goes_on = fault.reaction == GOES_ON
    trial.recording, trial.lost = recorded, recorded.short if goes_on else recorded.missing
    counted = goes_on and trial.lost > 0
    if not recorded.same:
        trial.problems.append("the recording differs from the undisturbed pass")
    # of a recorder that was killed before it closed its first chunk of the pass there is nothing to compare
    due = "identical" if recorded.started or not recorded.cut_off else "incomplete"
    if again and recorded.verdict != due and not counted:
        trial.problems.append(f"recomputed: {recorded.verdict}")
    if goes_on and not recorded.complete and not any(NOT_COMPLETE in message.sentence for message in graph.messages):
        trial.problems.append("the recording does not hold the whole pass, and no message reports it")
    if fault.reaction == ENDS and recorded.missing:
        trial.problems.append(f"{recorded.missing} messages are missing before the fault")
    if recorded.behind_s > BEHIND:
        trial.problems.append(f"the recording ends {recorded.behind_s:.2f} s before the fault")
