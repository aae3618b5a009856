"""Settings of the site: `make site`."""

from deep_curiosity import __version__

project = "deep_curiosity"
author = "The deep_curiosity authors"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
myst_fence_as_directive = ["math"]  # as the repository's own pages write formulas
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
default_role = "code"  # names in docstrings stand between single backticks
napoleon_google_docstring = True
napoleon_use_ivar = True
html_theme = "furo"
html_title = f"deep_curiosity {release}"
html_theme_options = {
    "source_repository": "https://github.com/deep-curiosity/deep-curiosity/",
    "source_branch": "main",
    "source_directory": "docs/",
}
suppress_warnings = [
    "myst.xref_missing",  # files of the repository; a test follows every link
    "toc.not_included",  # tables that a page of results links
]
