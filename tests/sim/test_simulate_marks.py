"""A loss of signal as the operator sees it: the display marks the last picture until one comes."""

from dataclasses import replace

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.media.showing import REDRAW_NS, Drawing, Screen
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.simulate import simulate
from telepresence.link.radio import load_radio

DARK_S = 1.2


@pytest.fixture
def drawn(monkeypatch):
    """Record (instant, age in the mark) of all that is drawn of the uplink picture."""
    rows = []
    now = {}

    def noted(name):
        handle = getattr(Screen, name)

        def run(self, *arguments):
            now[self] = arguments[-1]
            handle(self, *arguments)

        monkeypatch.setattr(Screen, name, run)

    next_event = Screen.next_event

    def record(self):
        drawing = next_event(self)
        if isinstance(drawing, Drawing) and drawing.stream == "uplink_video":
            rows.append((now[self], drawing.stale_ns))
        return drawing

    noted("handle_picture")
    noted("handle_time")
    monkeypatch.setattr(Screen, "next_event", record)
    return rows


def test_the_last_picture_is_marked_until_the_signal_is_back(tmp_path, drawn):
    radio = tmp_path / "radio.toml"
    radio.write_text(f"delay_ms = 2.0\n[[blackouts]]\nstart_s = 1.0\nseconds = {DARK_S}\n")
    setup = replace(load_setup("taskboard"), radio=load_radio(str(radio)))
    report = simulate(setup, seed=1, seconds=2.6)
    marks = [(now_ns, age_ns) for now_ns, age_ns in drawn if age_ns is not None]
    first_ns, last_ns = marks[0][0], marks[-1][0]
    stale_ns = setup.stale_after_ns(setup.uplink_video)
    # All of them are of one picture, captured before the loss of signal.
    assert len({now_ns - age_ns for now_ns, age_ns in marks}) == 1
    assert marks[0][1] == stale_ns
    assert {int(gap) for gap in np.diff([now_ns for now_ns, _ in marks])} == {REDRAW_NS}
    # Drawn in time's order, with nothing unmarked between them, and unmarked afterwards.
    assert [now_ns for now_ns, _ in drawn] == sorted(now_ns for now_ns, _ in drawn)
    between = [age_ns for now_ns, age_ns in drawn if first_ns <= now_ns <= last_ns]
    assert None not in between
    fresh_ns = next(now_ns for now_ns, age_ns in drawn if now_ns > last_ns)
    assert fresh_ns < round((1.0 + DARK_S + 0.3) * NS_PER_S)
    stream = report.streams["uplink_video"]
    assert stream.display.stale_episodes == 1
    assert abs(stream.display.stale_ns - (fresh_ns - first_ns)) < NS_PER_MS
