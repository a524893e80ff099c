const given = JSON.parse(document.getElementById("data").textContent);
for (const [name, show, data] of [["curve", curveFigure, given.curve], ["bend", bendFigure, given.bend],
  ["film", filmFigure, given.film]]) {
  if (!data) continue;
  const figure = document.getElementById(name);
  figure.hidden = false;
  show(figure, data);
  for (const still of document.querySelectorAll(`[data-instead=${name}]`)) still.hidden = true;
}

function unfold() {
  const target = document.getElementById(location.hash.slice(1)), folded = target && target.closest("details");
  if (folded) folded.open = true;
}
addEventListener("hashchange", unfold);
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => { one.open = true; }));
unfold();
