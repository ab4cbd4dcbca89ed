// Sorts tables, saves pictures, and draws the interactive plot of loops.
"use strict";

const STAGES = ["–", "1, slip", "2, stick", "3, build-up", "in the gap"];

for (const link of document.querySelectorAll("a[data-picture]")) {
  // saved from the page itself, which may be without the run folder
  link.href = document.getElementById(link.dataset.picture).src;
}

for (const button of document.querySelectorAll("th button.sort")) {
  button.addEventListener("click", () => {
    const head = button.closest("th");
    const body = button.closest("table").tBodies[0];
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of head.parentElement.children) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const key = (row) => row.children[head.cellIndex].dataset.value ?? "";
    const rows = [...body.rows].sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      if (x === "" || y === "") return (x === "") - (y === "");  // unknown values last
      const order = isNaN(x) || isNaN(y) ? x.localeCompare(y, undefined, {numeric: true}) : x - y;
      return up ? order : -order;
    });
    body.append(...rows);
  });
}

const explorer = document.getElementById("explorer");
if (explorer && window.Bokeh) {
  const {systems, tests} = JSON.parse(document.getElementById("explorer-data").textContent);
  const item = JSON.parse(document.getElementById("explorer-item").textContent);
  const choice = document.getElementById("explorer-test");
  const chosenUnits = () => document.querySelector('input[name="units"]:checked').value;
  const name = () => {
    tests.forEach((test, at) => { choice.options[at].textContent = test.name[chosenUnits()]; });
  };
  tests.forEach((test, at) => choice.add(new Option("", at)));

  const unpacked = (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  };
  const span = (...arrays) => {
    let [low, high] = [Infinity, -Infinity];
    for (const array of arrays) {
      for (const value of array) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    const margin = 0.04 * (high - low) || 1;
    return [low - margin, high + margin];
  };
  const show = (range, [start, end]) => {
    Object.assign(range, {start, end, reset_start: start, reset_end: end});
  };

  const draw = (model) => {
    const system = systems[chosenUnits()];
    const test = tests[choice.value];
    const scaled = (name, by) => unpacked(test[name]).map((value) => value * by);
    const [length, force] = system.by;
    const data = {
      x: scaled("displacement", length), t: scaled("time", 1), force: scaled("force", force),
      median: scaled("median", force), lower: scaled("lower", force), upper: scaled("upper", force),
      stage: [...test.stage].map((number) => STAGES[number]),
    };
    model.get_model_by_name("samples").data = data;
    const heights = span(data.lower, data.upper, data.force.filter((value) => !isNaN(value)));
    const labels = {x: `displacement, ${system.length}`, t: "time, s"};
    for (const along of ["x", "t"]) {
      const plot = model.get_model_by_name(`plot-${along}`);
      show(plot.x_range, span(data[along]));
      show(plot.y_range, heights);
      plot.below[0].axis_label = labels[along];
      plot.left[0].axis_label = `force, ${system.force}`;
      model.get_model_by_name(`hover-${along}`).tooltips = [
        ["time", "@t{0.000} s"],
        ["displacement", `@x{0.000} ${system.length}`],
        ["force", `@force{0.000} ${system.force}`],
        ["predicted", `@median{0.000} ${system.force} (@lower{0.000} to @upper{0.000})`],
        ["stage", "@stage"],
      ];
    }
    document.getElementById("explorer-role").textContent =
      test.fitted ? "fitted" : "predicted, not fitted";
  };

  explorer.hidden = false;
  Bokeh.embed.embed_item(item, "explorer-plot").then(() => {
    const model = Bokeh.documents[0];
    choice.addEventListener("change", () => draw(model));
    for (const units of document.querySelectorAll('input[name="units"]')) {
      units.addEventListener("change", () => { name(); draw(model); });
    }
    name();
    draw(model);
    explorer.dataset.ready = "yes";
  });
}
