"""The report page: templates, style sheet and scripts, and the values that go into them."""
