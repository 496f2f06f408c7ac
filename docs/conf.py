"""The site of the documentation: the guide's pages, and the reference from the docstrings.

python -m sphinx -W docs build/docs
"""

import gc
import html
import io
import re

import matplotlib
from docutils import nodes
from jinja2 import BaseLoader
from jinja2.sandbox import SandboxedEnvironment
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import math_to_image
from numpydoc import docscrape_sphinx
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.cli import given
from fenics_crack.scene import result_tables, tables
from fenics_crack.version import VERSION

# All pages are kept: a third of the time is a search for cycles in them. 0.9 GB, 0.4 with it.
gc.disable()

ENVIRONMENTS: dict[str, SandboxedEnvironment] = {}


def one_environment(loader: BaseLoader) -> SandboxedEnvironment:
    """Keep numpydoc's template compiled: it makes one for each of 1,300 docstrings."""
    return ENVIRONMENTS.setdefault("numpydoc", SandboxedEnvironment(loader=loader))


docscrape_sphinx.SandboxedEnvironment = one_environment

project = "fenics_crack"
author = "The fenics_crack developers"
copyright = author
release = VERSION

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc"]
html_theme = "furo"
html_title = f"fenics_crack {release}"
html_theme_options = {"light_css_variables": {"code-font-size": "0.72rem"}}
html_copy_source = False
html_domain_indices = False  # it would name one module
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = [("copy.js", {"defer": "defer"})]
smartquotes = False  # u'' is an acceleration
highlight_language = "none"  # indented blocks are formulas and commands
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "matplotlib"

# Docstrings have NumPy's form: types, shapes and units stand in them and not in the signatures.
numpydoc_show_class_members = False
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autosummary_generate = False
add_module_names = False

# References must exist, but types are words too, such as "(n,) [m]".
nitpicky = True
nitpick_ignore_regex = [("py:class", ".*")]


def lead_outside(app: Sphinx, *place_and_text: object) -> None:
    """Lead links to the benchmarks, outside of this folder, to their page in the notebook;
    those of the first page to the files beside the README."""
    text = place_and_text[-1]
    assert isinstance(text, list)
    pages = {"benchmarks/README": "notebook/benchmarks", "orbits/README": "notebook/orbits",
             "ADAPTERS": "notebook/adapters", r"\.\./README": "index"}  # fmt: skip
    for file, page in pages.items():
        text[0] = re.sub(rf"\((\.\./)*(benchmarks/)?(orbits/)?{file}\.md", f"(/{page}.md", text[0])
    for link in ("demos/first_notebook.ipynb", "CITATION.cff"):
        text[0] = text[0].replace(f"({link}", f"(../{link}")


def write_the_scene(app: Sphinx, page: str, text: list[str]) -> None:
    """Replace ``{{ new }}`` by the scene that ``fenics-crack new`` writes, and
    ``{{ quantities }}`` by the table of observables."""
    scene = given.build_scene_text("plate.toml", "measured.csv", ())
    text[0] = text[0].replace("{{ new }}", scene.rstrip())
    rows = (
        f"| `{name}` | {row.words} | {row.unit.replace('1', '-')} | {row.place.value} |"
        for name, row in OBSERVABLES_BY_NAME.items()
    )
    text[0] = text[0].replace("{{ quantities }}", "\n".join(rows))


def show_what_returns(
    app: Sphinx, what: str, name: str, thing: object, options: object, signature: str, _: object
) -> tuple[str, str | None]:
    """Return the signature with its default values, and the type of the return value."""
    returned = getattr(thing, "__annotations__", {}).get("return")
    return signature, returned if what in ("function", "method") else None


def say_what_is_allowed(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Add the allowed values and the unit below each key of a scene, in the words of its error."""
    kind, _, key = re.sub(r"fenics_crack\.scene\.(result_)?tables\.", "", name).partition(".")
    table = getattr(tables, kind, None) or getattr(result_tables, kind, None)
    if field := getattr(table, "__dataclass_fields__", {}).get(key):
        lines += ["", f"Allowed: {field.metadata['allowed']}.", ""]


def typeset(page: HTML5Translator, node: nodes.Element) -> None:
    """Draw a formula in the page: by matplotlib, without a network and without LaTeX."""
    source, drawing = node.astext().strip(), io.StringIO()
    with matplotlib.rc_context({"mathtext.fontset": "stix", "svg.hashsalt": "formula"}):
        depth = math_to_image(f"${source}$", drawing, FontProperties(size=12), format="svg")
    svg = drawing.getvalue()
    look = f'role="img" aria-label="{html.escape(source)}" fill="currentColor"'
    svg = svg[svg.index("<svg ") :].replace(
        "<svg ", f'<svg {look} style="overflow: visible; vertical-align: -{depth}pt" ', 1
    )
    block = isinstance(node, nodes.math_block)
    page.body.append(f'<p class="formula">{svg}</p>' if block else svg)
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_html_math_renderer("matplotlib", (typeset, None), (typeset, None))
    app.add_lexer("geo", TextLexer)  # gmsh's language
    app.connect("autodoc-process-docstring", say_what_is_allowed)
    app.connect("autodoc-process-signature", show_what_returns)
    app.connect("source-read", lead_outside)
    app.connect("include-read", lead_outside)
    app.connect("source-read", write_the_scene)
