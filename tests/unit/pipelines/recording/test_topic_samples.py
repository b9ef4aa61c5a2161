"""The order in which the samples of several topics are read."""

from contextlib import nullcontext
from itertools import count

import pytest

from pipelines.recording.topic_samples import waiting_samples


def lease(text):
    sample = nullcontext()
    sample.octets, sample.stamp, sample.published_ns = (lambda: text), None, 0
    return sample


class Topic:
    """A topic that is read. meanwhile: at each look, what another process does beside."""

    def __init__(self, meanwhile):
        self.waiting, self.meanwhile = [], meanwhile

    def next(self):
        self.meanwhile()
        return lease(self.waiting.pop(0)) if self.waiting else None


@pytest.mark.parametrize("due", range(1, 5))
def test_a_report_is_behind_its_telecommand_whenever_both_are_published(due):
    looks = count(1)

    def answer():
        if next(looks) == due:
            commands.waiting.append("command")
            reports.waiting.append("report")

    commands, reports = Topic(answer), Topic(answer)
    readers = [("commands", commands), ("reports", reports)]
    read = [one.octets for _ in range(3) for one in waiting_samples(readers)]
    assert read == ["command", "report"]
