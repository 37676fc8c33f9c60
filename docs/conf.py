"""The documentation site: `make docs` builds it from stored outputs, `make docs-all` executes every
page first."""

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent))

import srsinv  # noqa: E402
from docs.tools import formulas, reference  # noqa: E402

project = "srsinv"
author = copyright = "the srsinv developers"
version = release = srsinv.__version__

extensions = ["myst_nb", "sphinx_design", "sphinx_copybutton"]
exclude_patterns = ["_build", "stored", "tools"]
root_doc = "index"
nitpicky = True

# Pages hold no outputs: those of the last execution are attached as a page is read.
nb_custom_formats = {".md": ["docs.tools.stored.with_outputs", {}, False]}
nb_execution_mode = "off"
nb_execution_cache_path = str(DOCS / "_build" / "jupyter_cache")
nb_render_markdown_format = "myst"
nb_merge_streams = True
myst_enable_extensions = ["colon_fence", "dollarmath", "deflist", "attrs_inline"]
myst_heading_anchors = 4
myst_dmath_double_inline = True
suppress_warnings = ["myst.header"]  # docstrings begin below a heading

# Nothing is fetched: formulas are MathML, which browsers draw themselves.
html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "srsinv"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "header_links_before_dropdown": 6,
    "pygments_light_style": "default",
    "pygments_dark_style": "github-dark",
}
copybutton_exclude = ".linenos, .gp, .go"


def setup(app):
    app.add_html_math_renderer("mathml", formulas.INLINE, formulas.DISPLAYED)
    app.connect("builder-inited", lambda app: reference.write(DOCS))
