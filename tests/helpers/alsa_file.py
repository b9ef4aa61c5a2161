"""A real ALSA device without hardware: the `file` plug-in before the `null` one."""


def make_alsa_file(tmp_path, monkeypatch, *, played="/dev/null", recorded=""):
    """Make the device `played`; it writes what it plays, and records what a file has."""
    config = tmp_path / "asound.conf"
    config.write_text(
        "</usr/share/alsa/alsa.conf>\n"
        f"pcm.played {{ type file; slave.pcm null; file {played}; format raw;"
        f"{f' infile {recorded};' if recorded else ''} }}\n"
    )
    monkeypatch.setenv("ALSA_CONFIG_PATH", str(config))
