"""The types of the page's texts are those that the server packs."""

import importlib.util

from positions import ROOT


def test_the_types_are_up_to_date():
    spec = importlib.util.spec_from_file_location("texts_js", ROOT / ".ci" / "web" / "texts.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.FILE.read_text(encoding="utf-8") == module.texts_js(), (
        "run: python .ci/web/texts.py"
    )
