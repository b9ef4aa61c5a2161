"""The recipes of docs/python.md run as they stand, but for their ports."""

import re
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from common import free_port
from positions import ROOT

import kontur_av as ka

PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
IMPORT, *RECIPES = re.findall(r"```python\n(.*?)```", PAGE.partition("## Reference")[0], re.DOTALL)
PICTURES = [np.full((480, 640, 3), 40 + number, np.uint8) for number in range(40)]
BLOCKS = [np.full(960, 1000, np.int16)] * 40


def run(recipe, **names):
    exec(IMPORT + recipe, names)


def recipe(word):
    (found,) = (one for one in RECIPES if word in one)
    return found


def test_no_recipe_has_more_than_six_lines():
    assert len(RECIPES) == 6
    assert max(one.count("\n") for one in RECIPES) <= 6


def received(port, send, **how):
    """What a receiver gets of the stream that `send` sends to `port`."""
    with ka.StreamReceiver(port=port, **how) as stream, ThreadPoolExecutor() as pool:
        sending = pool.submit(send)
        sending.add_done_callback(lambda done: done.exception() and stream.close())
        items = list(stream)
        sending.result()
    assert stream.ended == "goodbye"
    return items


def test_pictures_are_sent_and_received():
    port, seen = free_port(more=1), []
    send, receive = (
        recipe(word).replace("5004", str(port)) for word in ("PictureSender", "StreamReceiver")
    )
    sender = threading.Thread(target=run, args=(send,), kwargs={"pictures": PICTURES})
    sender.start()
    run(receive, show=lambda *one: seen.append(one))
    sender.join()
    assert seen and all(data.shape == (480, 640, 3) and age_ms >= 0 for data, age_ms in seen)


def test_a_source_is_sent(monkeypatch):
    monkeypatch.chdir(ROOT / "samples")
    port = free_port(more=1)
    text = recipe("ka.send(").replace("5004", str(port))
    items = received(port, lambda: run(text))
    assert items and items[0].data.shape == (480, 640, 3)


def test_voice_is_sent():
    port = free_port(more=1)
    text = recipe("SoundSender").replace("5006", str(port))
    items = received(port, lambda: run(text, blocks=BLOCKS), codec="opus")
    assert items and items[-1].data.dtype == np.int16


@pytest.mark.parametrize("word", ["H264Encoder", "TopicBus"])
def test_a_recipe_without_a_network(word, capsys):
    seen = []
    run(recipe(word), pictures=PICTURES, show=seen.append)
    if word == "TopicBus":
        assert capsys.readouterr().out == "b'hello'\n"
    else:
        # Coded pictures have a size of their own.
        assert len(seen) == len(PICTURES) and seen[-1].ndim == 3
        assert abs(seen[-1].astype(int).mean() - 79) < 2


def test_the_import_of_a_name_loads_no_codec_and_no_event_loop():
    names = "PictureSender, kontur_av.StreamReceiver"
    code = f"import sys, kontur_av; kontur_av.{names}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    assert {"av", "cv2", "asyncio", "aiortc", "ssl"}.isdisjoint(loaded.split())
    assert "kontur_av.streams.senders" in loaded
