"""A printed page as vector shapes in millimetres, and as SVG and PDF text. y runs downwards from the top left corner.

The black cells of a marker are one path, so that no renderer shows hairlines between them. Nothing depends on the day:
the same page gives the same bytes.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import escape

from autopilot.core.frames import FloatArray

PT_PER_MM = 72.0 / 25.4
GREY = 0.45
"""Of text and marks that are not part of a marker."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedText:
    """A line of text, its baseline starting at x, y."""

    x_mm: float
    y_mm: float
    height_mm: float
    """Font size."""
    text: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PrintedPage:
    width_mm: float
    height_mm: float
    shapes: list[list[FloatArray]] = field(default_factory=list)
    """Black shapes, each a list of polygons (k, 2)."""
    lines: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Thin grey lines x0, y0, x1, y1."""
    texts: list[PrintedText] = field(default_factory=list)


def _n(value: float) -> str:
    """A number as short as 0.1 micrometre allows."""
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def svg_text(page: PrintedPage) -> str:
    """The page as an SVG document in true size."""
    w, h = _n(page.width_mm), _n(page.height_mm)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{w}mm" height="{h}mm" viewBox="0 0 {w} {h}">',
        f'<rect width="{w}" height="{h}" fill="#fff"/>',
    ]
    for shape in page.shapes:
        data = "".join("M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in polygon) + "Z" for polygon in shape)
        out.append(f'<path d="{data}" fill="#000"/>')
    grey = f"#{round(255 * GREY):02x}" + f"{round(255 * GREY):02x}" * 2
    out += [
        f'<line x1="{_n(x0)}" y1="{_n(y0)}" x2="{_n(x1)}" y2="{_n(y1)}" stroke="{grey}" stroke-width="0.15"/>'
        for x0, y0, x1, y1 in page.lines
    ]
    out += [
        f'<text x="{_n(t.x_mm)}" y="{_n(t.y_mm)}" font-family="Helvetica, Arial, sans-serif"'
        f' font-size="{_n(t.height_mm)}" fill="{grey}">{escape(t.text)}</text>'
        for t in page.texts
    ]
    return "\n".join([*out, "</svg>"]) + "\n"


def _content(page: PrintedPage) -> bytes:
    """PDF drawing commands of a page, in millimetres with y upwards."""
    top = page.height_mm
    out = [f"{PT_PER_MM:.8f} 0 0 {PT_PER_MM:.8f} 0 0 cm", "0 g"]
    for shape in page.shapes:
        for polygon in shape:
            steps = [f"{_n(x)} {_n(top - y)} {'l' if k else 'm'}" for k, (x, y) in enumerate(polygon)]
            out.append(" ".join([*steps, "h"]))
        out.append("f")
    out.append(f"{GREY} g {GREY} G 0.15 w")
    out += [f"{_n(x0)} {_n(top - y0)} m {_n(x1)} {_n(top - y1)} l S" for x0, y0, x1, y1 in page.lines]
    for t in page.texts:
        plain = t.text.encode("latin-1", "replace").decode("latin-1")
        safe = plain.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        out.append(f"BT /F1 {_n(t.height_mm)} Tf {_n(t.x_mm)} {_n(top - t.y_mm)} Td ({safe}) Tj ET")
    return "\n".join(out).encode("latin-1")


def pdf_bytes(pages: Sequence[PrintedPage]) -> bytes:
    """All pages as one PDF 1.4 document that asks printers for 100 % scale."""
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>".encode(),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    for k, page in enumerate(pages):
        box = f"[0 0 {page.width_mm * PT_PER_MM:.4f} {page.height_mm * PT_PER_MM:.4f}]"
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Resources << /Font << /F1 3 0 R >> >>"
            f" /Contents {5 + 2 * k} 0 R >>".encode()
        )
        stream = zlib.compress(_content(page), 9)
        head = f"<< /Length {len(stream)} /Filter /FlateDecode >>\nstream\n".encode()
        objects.append(head + stream + b"\nendstream")
    result = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n")
    places = []
    for number, body in enumerate(objects, start=1):
        places.append(len(result))
        result += f"{number} 0 obj\n".encode() + body + b"\nendobj\n"
    table = len(result)
    result += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode()
    result += b"".join(f"{place:010d} 00000 n \n".encode() for place in places)
    result += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n".encode()
    return bytes(result)
