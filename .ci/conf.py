"""Settings of the pages that .ci/docs makes from the docstrings."""

import re

project = "kr270_milling"
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "alabaster"
html_use_index = html_domain_indices = html_copy_source = False  # the search knows all names
autodoc_member_order = "bysource"
autodoc_typehints = "description"
#: a short name in an annotation that several modules have (Channel, type) links to none of them
suppress_warnings = ["ref.python"]


def plain_text(app, what, name, obj, options, lines):
    """Formulas are in docstrings as plain text: |s|, h_1 and a * b are no markup."""
    for n, line in enumerate(lines):
        words = re.split(r"(``.+?``)", line)
        lines[n] = "".join(w if w.startswith("``") else re.sub(r"([|*]|_(?=\W|$))", r"\\\1", w) for w in words)


def setup(app):
    app.connect("autodoc-process-docstring", plain_text)
