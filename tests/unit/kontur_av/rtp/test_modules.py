import sys

import pytest

from kontur_av.rtp.modules import package_not_run


def test_a_module_loads_without_its_package_and_the_package_loads_afterwards(tmp_path, monkeypatch):
    package = tmp_path / "heavy_package"
    package.mkdir()
    package.joinpath("__init__.py").write_text("ran = True\nfrom heavy_package import light\n")
    package.joinpath("light.py").write_text("from . import lighter\nlit = lighter.lit\n")
    package.joinpath("lighter.py").write_text("lit = 5\n")
    monkeypatch.syspath_prepend(tmp_path)
    with package_not_run("heavy_package"):
        import heavy_package.light as light

        assert not hasattr(sys.modules["heavy_package"], "ran")
    assert light.lit == 5
    assert not [name for name in sys.modules if name.startswith("heavy_package")]

    import heavy_package

    assert heavy_package.ran and heavy_package.light.lit == 5
    with package_not_run("heavy_package"):  # it has run: it stays
        pass
    assert sys.modules["heavy_package"] is heavy_package


def test_a_missing_package_is_missing_within_the_block():
    with pytest.raises(ModuleNotFoundError), package_not_run("no_such_package"):
        import no_such_package  # noqa: F401
