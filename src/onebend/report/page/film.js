// The film, frame by frame, with the fitted beam, the measured tags and the force over it.
function filmFigure(figure, data) {
  const chart = figure.querySelector(".chart"), readout = figure.querySelector(".readout");
  const slider = figure.querySelector("input"), last = data.frames.length - 1;
  chart.replaceChildren();
  const svg = drawn(chart, "svg", { width: "100%", viewBox: `0 0 ${data.width} ${data.height}` });
  const picture = drawn(svg, "image", { width: data.width, height: data.height }), over = drawn(svg, "g", {});

  function show() {
    const one = data.frames[Number(slider.value)], path = pathOf(one.beam_px), size = Math.hypot(...one.force_N);
    picture.setAttribute("href", one.picture);
    over.replaceChildren();
    drawn(over, "path", { d: pathOf(one.band_px) + "Z", fill: BLUE, "fill-opacity": 0.35, stroke: "none" });
    for (const [tint, wide] of [["#fff", 5], [BLUE, 2.5]]) {
      drawn(over, "path", { d: path, fill: "none", stroke: tint, "stroke-width": wide });
    }
    for (const [cx, cy] of one.tags_px) {
      drawn(over, "circle", { cx, cy, r: 7, fill: "none", stroke: "#fff", "stroke-width": 4 });
      drawn(over, "circle", { cx, cy, r: 7, fill: "none", stroke: ORANGE, "stroke-width": 2 });
    }
    const [[x1, y1], [x2, y2]] = one.arrow_px;
    for (const [tint, wide] of [["#fff", 6], [ORANGE, 3]]) {
      drawn(over, "line", { x1, y1, x2, y2, stroke: tint, "stroke-width": wide });
    }
    drawn(over, "circle", { cx: x2, cy: y2, r: 4, fill: ORANGE });
    readout.textContent = `frame ${one.frame} · ${one.time_s.toFixed(2)} s after the first shown · F = `
      + `(${digits(one.force_N[0])}, ${digits(one.force_N[1])}) N, ${digits(size)} N as fitted`;
  }

  slider.max = last;
  slider.addEventListener("input", show);
  const sizes = data.frames.map((one) => Math.hypot(...one.force_N));
  slider.value = sizes.indexOf(Math.max(...sizes));
  show();
}
