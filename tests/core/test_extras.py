"""The remedy for a missing library is that of the installation."""

from imucald.core import extras


def test_the_remedy_is_a_package_where_imucald_is_one(monkeypatch):
    assert extras.how_to_install("report") == "pip install '.[report]' in imucald's checkout"
    monkeypatch.setattr(extras, "__file__", "/usr/lib/imucald/imucald/core/extras.py")
    assert "imucald-workbench" in extras.how_to_install("report")
    assert "'.[mqtt]'" in extras.how_to_install("mqtt")
