"""Sphinx configuration of the site; `python3 run.py docs` builds it."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))
sys.path.insert(0, str(HERE.parent / "src"))

import planish  # noqa: E402

project = "planish"
author = "The planish developers"
release = version = planish.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "from_code"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "_ext"]
# Quotes and dots only: two hyphens in the text are those of an option, not a dash.
smartquotes_action = "qe"
# Docstrings name a class by its short name, which several packages may have: that is no broken
# link.
suppress_warnings = ["ref.python"]

# Headings get the anchors that the files have where they are read as Markdown: `page.md#a-heading`.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]

# A block without a language is output or commands, which no colours fit.
highlight_language = "text"

# The signature says names and defaults; what each of them is stands in the docstring, with shape
# and unit.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
toc_object_entries = False
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "pydata_sphinx_theme"
html_title = "planish"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_favicon = "_static/planish.svg"
# A page may be read from a folder without a server: then a script cannot fetch other pages for
# their first lines.
html_show_search_summary = False
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_theme_options = {
    "logo": {
        "text": "planish",
        "image_light": "_static/planish.svg",
        "image_dark": "_static/planish.svg",
    },
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "navbar_persistent": ["search-button"],
    "header_links_before_dropdown": 6,
    "show_nav_level": 1,
    "navigation_depth": 2,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_center": [],
    "footer_end": [],
    "article_footer_items": [],
    "show_version_warning_banner": False,
    "back_to_top_button": False,
}
html_sidebars = {page: [] for page in ("index", "tutorial", "examples", "app", "studies", "words")}
html_context = {"default_mode": "auto"}
