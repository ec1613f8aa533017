"""Contrast of the text that a page shows, by WCAG 2.1: 4.5 to 1, 3 to 1 for large text."""

from __future__ import annotations

from typing import Any

_MEASURE = """() => {
  const channel = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
  const luminance = ([r, g, b]) => 0.2126 * channel(r / 255) + 0.7152 * channel(g / 255) + 0.0722 * channel(b / 255);
  const parts = (text) => {
    const numbers = text.match(/[\\d.]+/g).map(Number);
    return numbers.length === 3 ? [...numbers, 1] : numbers;
  };
  const over = (top, below) => [0, 1, 2].map((i) => top[3] * top[i] + (1 - top[3]) * below[i]);
  const backdrop = (element) => {
    const layers = [];
    for (let at = element; at; at = at.parentElement) layers.push(parts(getComputedStyle(at).backgroundColor));
    return layers.reverse().reduce((below, layer) => over(layer, below), [255, 255, 255]);
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const element = node.parentElement, text = node.textContent.trim();
    if (!/[\\p{L}\\p{N}]/u.test(text) || ["SCRIPT", "STYLE", "OPTION"].includes(element.tagName)) continue;
    const style = getComputedStyle(element);
    if (style.visibility === "hidden" || !element.getClientRects().length) continue;
    const behind = backdrop(element), ink = over(parts(style.color), behind);
    const [light, dark] = [luminance(ink), luminance(behind)].sort((a, b) => b - a);
    const size = parseFloat(style.fontSize), bold = Number(style.fontWeight) >= 700;
    found.push({text: text.slice(0, 60), ratio: (light + 0.05) / (dark + 0.05), large: size >= 24 || (bold && size >= 18.66)});
  }
  return found;
}"""  # noqa: E501


def contrasts(page: Any) -> list[dict[str, Any]]:
    """Every text that is shown with its `ratio`, and whether it is `large`.

    Signs without letters or digits are no text, and pictures behind a text are not seen.
    """
    return page.evaluate(_MEASURE)


def too_faint(page: Any) -> list[str]:
    """Texts whose contrast is too small, with their ratio; a page without text is none."""
    found = contrasts(page)
    assert found, "the page shows no text"
    return [
        f"{text['text']}: {text['ratio']:.2f}"
        for text in found
        if text["ratio"] < (3.0 if text["large"] else 4.5)
    ]
