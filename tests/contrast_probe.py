"""Whether text stands out from its ground, by WCAG 2.1 AA and its own formula."""

from __future__ import annotations

from typing import Any

# Contrast of every piece of text against what lies below it
_CONTRASTS = """() => {
  const rgb = color => color.match(/[\\d.]+/g).map(Number);
  const linear = value => (value /= 255) <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  // what lies below a node, over a picture that may be anything: glass before black, and before white
  const grounds = node => {
    const glass = [];
    for (; node; node = node.parentElement) {
      const [r, g, b, alpha = 1] = rgb(getComputedStyle(node).backgroundColor);
      if (alpha > 0) glass.unshift([[r, g, b], alpha]);
      if (alpha === 1) break;
    }
    const mixed = (below, [color, alpha]) => color.map((one, k) => alpha * one + (1 - alpha) * below[k]);
    const over = ground => glass.reduce(mixed, ground);
    return [over([0, 0, 0]), over([255, 255, 255])];
  };
  const found = [], texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let text = texts.nextNode(); text; text = texts.nextNode()) {
    const node = text.parentElement, svg = node.closest("svg"), style = getComputedStyle(node);
    if (style.textShadow !== "none") continue; // it brings its own ground along
    if (!text.textContent.trim() || !node.checkVisibility() || /^(script|style)$/i.test(node.tagName)) continue;
    const ink = luminance(rgb(svg ? style.fill : style.color));
    const contrast = Math.min(...grounds(node).map(below => {
      const [one, other] = [ink, luminance(below)].sort((a, b) => b - a);
      return (one + 0.05) / (other + 0.05);
    }));
    const size = parseFloat(style.fontSize), large = size >= 24 || size >= 18.66 && style.fontWeight >= 700;
    found.push({ text: text.textContent.slice(0, 40), contrast, large });
  }
  return found;
}"""


def faint(page: Any, least: int) -> list[dict[str, Any]]:
    """The pieces of text of an open page whose contrast is below 4.5, or below 3 where they are large.

    Args:
        page: of Playwright.
        least: so many pieces of text there must be.
    """
    found = page.evaluate(_CONTRASTS)
    assert len(found) > least
    return [one for one in found if one["contrast"] < (3.0 if one["large"] else 4.5)]
