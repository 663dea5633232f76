"""Configuration of the site, which ``bash scripts/site.sh`` builds.

Nothing is fetched, neither while building nor while reading: equations become MathML (see
``_extensions/native_math.py``), the search is Sphinx's own, fonts are those of the system.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_extensions"))
sys.path.insert(0, str(HERE.parent))

from roadtorch.base.version import __version__  # noqa: E402

project = "roadtorch"
author = "the roadtorch authors"
project_copyright = "the roadtorch authors"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "generated_parts",
    "native_math",
    "plain_docstrings",
]
exclude_patterns = ["_extensions", "_static", "examples"]
root_doc = "index"
highlight_language = "none"
smartquotes = False  # --out is two hyphens
nitpicky = True
nitpick_ignore_regex = [
    # Other packages: their documentation is not available without a network.
    ("py:.*", r"(torch|np|numpy|pydantic|click|cv2|PIL|av|rosbags|safetensors|onnx|scipy)(\..*)?"),
    ("py:.*", r"(collections|typing|pathlib|os|enum|datetime|types|fractions|subprocess)(\..*)?"),
    ("py:.*", r"(AnyReader|Typestore|InputContainer|VideoFrame|VideoReformatter|VideoStream)"),
    ("py:class", r"(dict|list)\[.*"),  # halves of aliases
    # Types in signatures may be of modules that are not in the reference; errors of ``Raises:``.
    ("py:(class|data)", r"roadtorch\..*"),
    ("py:exc", r".*"),
]

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_default_options = {
    "members": True,
    "show-inheritance": False,
    "exclude-members": "model_config",
}
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88

html_theme = "pydata_sphinx_theme"
html_title = "roadtorch"
html_static_path = ["_static"]
html_sidebars = {name: [] for name in ("results", "limits", "faq", "contributing", "changelog")}
html_css_files = ["quiet.css"]
html_show_sourcelink = False
html_copy_source = True  # the search shows excerpts of it
html_math_renderer = "mathml"
html_theme_options = {
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "header_links_before_dropdown": 6,
    "show_prev_next": True,
    "collapse_navigation": True,
    "navigation_depth": 2,
    "secondary_sidebar_items": {"**": ["page-toc"], "research/tables": []},
    "footer_start": ["copyright"],
    "footer_end": [],
    "navigation_with_keys": False,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_context = {"default_mode": "auto"}
