"""Settings of the site that .ci/docs makes."""

import re

project = "kr270_milling"
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "myst_parser"]
root_doc = "README"
html_theme = "furo"
html_title = "kr270_milling"
html_extra_path = ["extra"]  # beside the pages: demo/report.html
html_use_index = html_domain_indices = html_copy_source = False  # the search knows all names
autodoc_member_order = "bysource"
autodoc_typehints = "description"
myst_heading_anchors = 4
#: a short name in an annotation that several modules have (Channel, type) links to none of them
suppress_warnings = ["ref.python"]


def plain_text(app, what, name, obj, options, lines):
    """Formulas are in docstrings as plain text: |s|, h_1 and a * b are no markup."""
    for n, line in enumerate(lines):
        words = re.split(r"(``.+?``)", line)
        lines[n] = "".join(w if w.startswith("``") else re.sub(r"([|*]|_(?=\W|$))", r"\\\1", w) for w in words)


def short_tree(app, pagename, templatename, context, doctree):
    """Show in the sidebar the branch of the page alone: the whole tree of 300 pages on each takes minutes."""
    if tree := context.get("toctree"):
        context["toctree"] = lambda **options: tree(**{**options, "collapse": True})


def setup(app):
    app.connect("html-page-context", short_tree, priority=100)  # before the theme
    app.connect("autodoc-process-docstring", plain_text)
