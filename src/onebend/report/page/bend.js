// The learned beam under a force that is dragged: the soft spring between the beam and the handle is the force.
function bendFigure(figure, data) {
  const chart = figure.querySelector(".chart"), readout = figure.querySelector(".readout");
  const place = figure.querySelector("input"), made = madeOf(data), L = data.length_m;
  const spring = data.force_N / (0.4 * L), most = 3 * data.force_N;
  let at = data.at_s, force = [0, 0], a = equilibrium(made, force, at, null), view = null;

  function draw() {
    const width = Math.max(chart.clientWidth, 240), height = Math.min(Math.max(0.8 * width, 260), 480);
    const scale = Math.min(width / (1.8 * L), height / (2.2 * L));
    view = { scale, width, height, x: (x) => 0.5 * width + (x - 0.45 * L) * scale, y: (y) => height / 2 - y * scale };
    view.back = (px, py) => [(px - view.x(0)) / scale, (height / 2 - py) / scale];
    chart.replaceChildren();
    view.svg = drawn(chart, "svg", { width, height, viewBox: `0 0 ${width} ${height}` });
    const rest = lineOf(made, equilibrium(made, [0, 0], at, null)).map(([x, y]) => [view.x(x), view.y(y)]);
    drawn(view.svg, "path", { d: pathOf(rest), fill: "none", stroke: FAINT, "stroke-width": 5, "stroke-linecap": "round" });
    drawn(view.svg, "rect", { x: view.x(0) - 12, y: view.y(0) - 16, width: 12, height: 32, fill: INK });
    view.moving = drawn(view.svg, "g", {});
    view.handle = drawn(view.svg, "circle", { r: 20, fill: ORANGE, "fill-opacity": 0.25, stroke: ORANGE,
      "stroke-width": 2, class: "handle" });
    show();
  }

  function show() {
    const { x, y, moving, handle } = view, here = placeOf(made, a, at), tip = placeOf(made, a, 1);
    const goal = here.map((value, i) => value + force[i] / spring);
    moving.replaceChildren();
    const line = lineOf(made, a).map(([px, py]) => [x(px), y(py)]);
    drawn(moving, "path", { d: pathOf(line), fill: "none", stroke: BLUE, "stroke-width": 5, "stroke-linecap": "round" });
    drawn(moving, "line", { x1: x(here[0]), y1: y(here[1]), x2: x(goal[0]), y2: y(goal[1]), stroke: ORANGE,
      "stroke-width": 2.5 });
    drawn(moving, "circle", { cx: x(here[0]), cy: y(here[1]), r: 5, fill: ORANGE });
    handle.setAttribute("cx", Math.min(Math.max(x(goal[0]), 20), view.width - 20));
    handle.setAttribute("cy", Math.min(Math.max(y(goal[1]), 20), view.height - 20));
    const size = Math.hypot(...force), turn = 180 / Math.PI * a[PIECES - 1];
    const [fx, fy] = force.map((f) => digits(Math.abs(f) < 1e-6 * data.force_N ? 0 : f));
    const beyond = size > 1.001 * data.largest_N && data.largest_N > 0
      ? ` · more than the ${digits(data.largest_N)} N that it was learned under` : "";
    readout.textContent = `F = (${fx}, ${fy}) N, ${digits(size)} N at s = ${at.toFixed(2)} · `
      + `tip at (${digits(1000 * tip[0], 4)}, ${digits(1000 * tip[1], 4)}) mm, turned by ${turn.toFixed(1)}°${beyond}`;
    chart.setAttribute("aria-valuenow", size.toPrecision(3));
    chart.setAttribute("aria-valuetext", readout.textContent);
  }

  function pull(goal) {
    ({ force, a } = pulledTo(made, goal, at, spring, most, force, a));
    show();
  }

  function put(next) {
    const size = Math.hypot(...next);
    force = size > most ? next.map((f) => f * most / size) : next;
    a = equilibrium(made, force, at, a);
    show();
  }

  function dragged(event) {
    const box = chart.getBoundingClientRect();
    pull(view.back(event.clientX - box.left, event.clientY - box.top));
  }

  let held = false;
  chart.addEventListener("pointerdown", (event) => {
    if (event.target !== view.handle) return;
    held = true;
    chart.setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  chart.addEventListener("pointermove", (event) => { if (held) dragged(event); });
  for (const end of ["pointerup", "pointercancel"]) chart.addEventListener(end, () => { held = false; });
  chart.addEventListener("keydown", (event) => {
    const step = 0.05 * data.force_N;
    const ways = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (event.key === "Escape" || event.key === "Home") put([0, 0]);
    else if (event.key in ways) put(force.map((f, i) => f + ways[event.key][i]));
    else return;
    event.preventDefault();
  });
  place.value = at;
  place.addEventListener("input", () => { at = Number(place.value); put(force); });
  figure.querySelector("button").addEventListener("click", () => { a = equilibrium(made, [0, 0], at, null); put([0, 0]); });
  new ResizeObserver(draw).observe(chart);
  draw();
  put(data.first_N);
}
