"""Pages that an engineer can send on. Needs the extra `report` (jinja2, matplotlib)."""

from imucald.report.page import About, report_page, require_libraries

__all__ = ["About", "report_page", "require_libraries"]
