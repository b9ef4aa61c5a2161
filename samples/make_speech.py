"""Make the two speech samples of the built-in scenes with espeak-ng.

    python samples/make_speech.py [DIRECTORY]

Writes speech_ground.flac and speech_cabin.flac (16 kHz, mono) into DIRECTORY, by default the
`media` folder beside this script. Needs the program `espeak-ng` (apt install espeak-ng).
"""

import io
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

RATE_HZ = 16_000
#: -6 dBFS: a microphone with room to spare.
PEAK = 16_384

# (file, voice, words a minute, pitch 0..99, sentences)
SPEAKERS = (
    (
        "speech_ground.flac",
        "en-gb",
        150,
        38,
        "Ground to station. The stylus is above target two. "
        "You should feel the wall on the right, about two newtons.",
    ),
    (
        "speech_cabin.flac",
        "en-us",
        160,
        62,
        "Station here. I see the green light, and I feel the contact. Moving on to target three.",
    ),
)


def speak(voice: str, words_a_minute: int, pitch: int, text: str) -> NDArray[np.int16]:
    """`text` as mono samples of int16 at 16 kHz, half a second of silence after it."""
    command = ["espeak-ng", "-v", voice, "-s", str(words_a_minute), "-p", str(pitch)]
    wav = subprocess.run([*command, "--stdout", text], check=True, capture_output=True).stdout
    resampler = av.AudioResampler("s16", "mono", RATE_HZ)
    pieces = []
    with av.open(io.BytesIO(wav), "r") as container:
        for frame in container.decode(audio=0):
            pieces += [piece.to_ndarray()[0] for piece in resampler.resample(frame)]
    pieces += [piece.to_ndarray()[0] for piece in resampler.resample(None)]
    samples = np.concatenate([*pieces, np.zeros(RATE_HZ // 2, np.int16)]).astype(np.float64)
    return np.asarray((samples * PEAK / np.abs(samples).max()).astype(np.int16))


def write_flac(path: Path, samples: NDArray[np.int16]) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            "flac", rate=RATE_HZ, layout="mono", options={"compression_level": "12"}
        )
        frame = av.AudioFrame.from_ndarray(samples[np.newaxis], format="s16", layout="mono")
        frame.sample_rate = RATE_HZ
        fifo = av.AudioFifo()
        fifo.write(frame)
        while (piece := fifo.read(4096, partial=True)) is not None:
            container.mux(stream.encode(piece))
        container.mux(stream.encode(None))


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "media"
    for name, voice, words_a_minute, pitch, text in SPEAKERS:
        samples = speak(voice, words_a_minute, pitch, text)
        write_flac(folder / name, samples)
        octets = (folder / name).stat().st_size
        print(f"{folder / name}: {len(samples) / RATE_HZ:.1f} s, {octets} octets")


if __name__ == "__main__":
    main()
