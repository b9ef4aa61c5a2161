"""A libopus from the system or from PyAV."""

import pytest

from kontur_av.codecs import libopus
from kontur_av.errors import ConfigError


def test_no_libopus_at_all_names_the_mend(monkeypatch):
    monkeypatch.setattr(libopus.ctypes.util, "find_library", lambda name: None)
    monkeypatch.setattr(libopus, "carried_by_pyav", lambda name: None)
    with pytest.raises(ConfigError, match="libopus0"):
        libopus.load.__wrapped__()
