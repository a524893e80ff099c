const SVG = document.querySelector("svg").namespaceURI;
const BLUE = "#0072b2", ORANGE = "#d55e00", GREY = "#98a2b3", INK = "#1b2430", MUTED = "#667085", FAINT = "#d5dae1";

function drawn(parent, name, attributes, text) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  parent.appendChild(node);
  return node;
}

function digits(value, count = 3) {
  if (!Number.isFinite(value)) return "–";
  const text = Number(value.toPrecision(count)), size = Math.abs(text);
  if (size === 0) return "0";
  if (size < 1e-4 || size >= 1e6) return value.toExponential(count - 1);
  return text.toFixed(Math.max(count - 1 - Math.floor(Math.log10(size)), 0));
}

// About `count` round numbers from low to high.
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((f) => f * power).find((one) => one >= rough * 0.999), out = [];
  for (let i = Math.ceil(low / step); i * step <= high * (1 + 1e-9); i++) out.push(i * step);
  return out.map((value) => Number(value.toPrecision(12)));
}

function pathOf(points) {
  return "M" + points.map(([x, y]) => `${x.toFixed(2)} ${y.toFixed(2)}`).join("L");
}

// k(s) with its bands, as wide as the page; a finger, a mouse or the arrow keys move along it.
function curveFigure(figure, data) {
  const chart = figure.querySelector(".chart"), readout = figure.querySelector(".readout");
  const count = data.k_N_m.length, known = data.known || data.k_N_m.map(() => true), wide = data.bands[0];
  const log = figure.querySelector("input");
  let s = 0.5, axes = null;

  function range() {
    const top = 1.15 * data.top_N_m;
    if (!log.checked) return [1.15 * data.lowest_N_m, top];
    const seen = (wide ? wide.low_N_m : data.k_N_m).filter((value, i) => known[i] && value > 0);
    return [0.8 * Math.min(...(seen.length ? seen : data.k_N_m.filter((value) => value > 0))), top];
  }

  function draw() {
    const width = Math.max(chart.clientWidth, 240), height = Math.min(Math.max(0.55 * width, 230), 400);
    const [left, right, top, bottom] = [52, 14, 12, 44], [low, high] = range(), scale = log.checked ? Math.log : Number;
    const x = (place) => left + place * (width - left - right);
    const y = (k) => {
      const part = (scale(log.checked ? Math.max(k, 1e-3 * low) : k) - scale(low)) / (scale(high) - scale(low));
      return height - bottom - Math.min(Math.max(part, -9), 9) * (height - top - bottom);
    };
    chart.replaceChildren();
    const svg = drawn(chart, "svg", { width, height, viewBox: `0 0 ${width} ${height}` });
    const box = [left, top, width - left - right, height - top - bottom];
    const inner = { x: box[0], y: box[1], width: box[2], height: box[3], viewBox: box.join(" ") };  // it cuts off
    const decades = log.checked && Math.log10(high / low) > 1.3;
    const marks = decades ? [1, 2, 5].flatMap((f) => [...Array(20).keys()].map((n) => f * 10 ** (n - 10)))
      .filter((k) => k > low && k < high) : ticks(low, high, 5);
    for (const k of marks) {
      drawn(svg, "line", { x1: left, x2: width - right, y1: y(k), y2: y(k), stroke: FAINT });
      drawn(svg, "text", { x: left - 6, y: y(k) + 4, "text-anchor": "end" }, digits(k, 2));
    }
    for (const place of [0, 0.2, 0.4, 0.6, 0.8, 1]) {
      drawn(svg, "line", { x1: x(place), x2: x(place), y1: top, y2: height - bottom, stroke: FAINT });
      drawn(svg, "text", { x: x(place), y: height - bottom + 16, "text-anchor": "middle" }, place.toFixed(1));
    }
    drawn(svg, "text", { x: (left + width - right) / 2, y: height - 8, "text-anchor": "middle" }, "place along the beam s");
    drawn(svg, "text", { x: left + 4, y: top + 12 }, "k [N m]");
    const inside = drawn(svg, "svg", inner);
    for (let from = 0; from < count - 1;) {
      let end = from + 1;
      while (end < count - 1 && known[end] === known[from]) end++;
      const places = [...Array(end - from + 1).keys()].map((i) => from + i), tint = known[from] ? BLUE : GREY;
      const along = (values) => places.map((i) => [x(i / (count - 1)), y(values[i])]);
      for (const band of data.bands) {
        const path = pathOf([...along(band.high_N_m), ...along(band.low_N_m).reverse()]) + "Z";
        drawn(inside, "path", { d: path, fill: tint, "fill-opacity": 1.4 * band.strength });
      }
      drawn(inside, "path", { d: pathOf(along(data.k_N_m)), fill: "none", stroke: tint, "stroke-width": 2 });
      from = end;
    }
    if (data.regression_N_m) {
      const line = data.regression_N_m.map((k, i) => [x(i / (count - 1)), y(k)]);
      drawn(inside, "path", { d: pathOf(line), fill: "none", stroke: ORANGE, "stroke-dasharray": "5 4" });
    }
    data.tag_s.forEach((place, i) => {
      drawn(svg, "circle", { cx: x(place), cy: height - bottom, r: 4, fill: INK });
      drawn(svg, "text", { x: x(place), y: height - bottom - 8, "text-anchor": "middle" }, data.tag_words[i]);
    });
    const mark = drawn(svg, "svg", inner);
    axes = { x, y, left, right, width, line: [top, height - bottom], mark };
    point();
  }

  function point() {
    const { x, y, line, mark } = axes, k = interpolated(data.k_N_m, s);
    const sure = known[Math.round(s * (count - 1))], tint = sure ? BLUE : GREY;
    mark.replaceChildren();
    drawn(mark, "line", { x1: x(s), x2: x(s), y1: line[0], y2: line[1], stroke: MUTED, "stroke-dasharray": "2 3" });
    const words = [`s = ${s.toFixed(2)}`, `${digits(1000 * s * data.length_m)} mm from the clamp`, `k = ${digits(k)} N m`];
    if (wide) {
      const [low, high] = [wide.low_N_m, wide.high_N_m].map((values) => interpolated(values, s));
      drawn(mark, "line", { x1: x(s), x2: x(s), y1: y(low), y2: y(high), stroke: tint, "stroke-width": 4 });
      words.push(`95 % band ${digits(low)} to ${digits(high)} N m`, sure ? "identified" : data.unknown);
    }
    drawn(mark, "circle", { cx: x(s), cy: y(k), r: 5, fill: tint, stroke: "#fff", "stroke-width": 1.5 });
    readout.textContent = words.join(" · ");
    chart.setAttribute("aria-valuenow", s.toFixed(2));
    chart.setAttribute("aria-valuetext", readout.textContent);
  }

  function to(place) {
    s = Math.min(Math.max(place, 0), 1);
    point();
  }

  function touched(event) {
    const { left, right, width } = axes;
    to((event.clientX - chart.getBoundingClientRect().left - left) / (width - left - right));
  }

  chart.addEventListener("pointermove", touched);
  chart.addEventListener("pointerdown", touched);
  chart.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: -0.01, ArrowDown: -0.01, ArrowRight: 0.01, ArrowUp: 0.01, PageDown: -0.1, PageUp: 0.1,
      Home: -1, End: 1 };
    if (!(event.key in steps)) return;
    event.preventDefault();
    to(Math.round(100 * (s + steps[event.key])) / 100);
  });
  log.addEventListener("change", draw);
  new ResizeObserver(draw).observe(chart);
  draw();
}
