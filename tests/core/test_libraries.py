"""The remedy for a missing library is that of the installation."""

from imucald.core import libraries


def test_the_remedy_is_a_package_where_imucald_is_one(monkeypatch):
    assert libraries.how_to_install("report") == "pip install '.[report]' in imucald's checkout"
    monkeypatch.setattr(libraries, "__file__", "/usr/lib/imucald/imucald/core/libraries.py")
    assert "imucald-workbench" in libraries.how_to_install("report")
    assert "'.[mqtt]'" in libraries.how_to_install("mqtt")
