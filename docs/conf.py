"""The documentation site: `make docs` builds it without a network; warnings are errors."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

from pcnav import __version__  # noqa: E402

project = "pcnav"
author = "The pcnav authors"
project_copyright = author
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "mathml",
    "short_types",
    "from_the_code",
    "self_contained",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_ext"]
highlight_language = "none"
smartquotes = False
# A name in backticks is one of the code where there is such a one.
default_role = "py:obj"

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
# Dollars around a formula with spaces, as in a table of prices, are none.
myst_dmath_allow_space = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80

html_theme = "furo"
html_title = f"pcnav {__version__}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
