"""Layout defects of a page, as JavaScript that runs in it."""

COLLIDING_TEXTS = """(() => {
  const shown = (one) => {
    const box = one.getBoundingClientRect(), style = getComputedStyle(one);
    return box.width > 0 && one.textContent.trim() !== "" && style.visibility !== "hidden" && style.opacity !== "0";
  };
  const found = [];
  for (const plot of document.querySelectorAll(".plot")) {
    const frame = plot.getBoundingClientRect();
    const things = Array.from(plot.querySelectorAll("svg text"))
      .filter(shown)
      .map((one) => ({ name: one.textContent, box: one.getBoundingClientRect() }));
    const bar = plot.querySelector(".modebar");
    if (bar) things.push({ name: "(tool bar)", box: bar.getBoundingClientRect() });
    things.forEach(({ name, box: a }, index) => {
      if (a.left < frame.left - 1 || a.right > frame.right + 1 || a.top < frame.top - 1 || a.bottom > frame.bottom + 1)
        found.push(`${plot.id}: '${name}' is cut off`);
      for (const { name: other, box: b } of things.slice(index + 1)) {
        const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (across > 1.5 && down > 3.5) found.push(`${plot.id}: '${name}' lies on '${other}'`);
      }
    });
  }
  return found;
})()"""
"""Texts of figures that lie on each other or beyond their figure; boxes are a few px higher than their text."""

OVERFLOW = """(() => {
  const width = document.scrollingElement.clientWidth, whole = document.scrollingElement.scrollWidth;
  const found = whole > width ? [`the page is ${whole} px wide, the window ${width} px`] : [];
  for (const one of document.querySelectorAll("main *, header *, nav *"))
    if (!one.closest(".scroll, .plot, pre, details:not([open])") && one.getBoundingClientRect().right > width + 1)
      found.push(`${one.tagName} '${one.textContent.trim().slice(0, 40)}'`);
  return found;
})()"""
"""What is wider than the window, but for what scrolls by itself."""
