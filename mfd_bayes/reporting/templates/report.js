// Writes numbers in the chosen units, saves pictures, and draws the interactive plot of loops.
"use strict";

const UNITS = JSON.parse(document.getElementById("units").textContent);
const STAGES = ["–", "1, slip", "2, stick", "3, build-up", "in the gap"];
const chosenUnits = () => document.querySelector('input[name="units"]:checked').value;

// As `symbols.number` writes it.
const written = (value, digits, short) => {
  if (short) {
    const rounded = Number(value.toPrecision(digits));
    return String(rounded).replaceAll("-", "−");
  }
  const power = value === 0 ? 0 : Number(value.toExponential(digits - 1).split("e")[1]);
  let text;
  if (power < -4 || power >= 6) text = value.toExponential(digits - 1).replace("e+", "e");
  else if (power >= digits) text = Number(value.toPrecision(digits)).toFixed(0);
  else text = value.toPrecision(digits);
  return text.replaceAll("-", "−");
};

const writeUnits = () => {
  const system = chosenUnits();
  for (const element of document.querySelectorAll("[data-unit]")) {
    const [by, name] = UNITS[element.dataset.unit][system];
    const {value, digits, short} = element.dataset;
    element.textContent =
      value === undefined ? name : written(value * by, Number(digits), short !== undefined);
  }
  for (const element of document.querySelectorAll("[data-system]")) {
    element.hidden = element.dataset.system !== system;
  }
};

document.querySelector("fieldset.units").hidden = false;
for (const choice of document.querySelectorAll('input[name="units"]')) {
  choice.addEventListener("change", writeUnits);
}

for (const link of document.querySelectorAll("a[data-picture]")) {
  // saved from the page itself, which may be without the run folder
  link.href = document.getElementById(link.dataset.picture).src;
}

const explorer = document.getElementById("explorer");
if (explorer && window.Bokeh) {
  const {systems, tests} = JSON.parse(document.getElementById("explorer-data").textContent);
  const item = JSON.parse(document.getElementById("explorer-item").textContent);
  const choice = document.getElementById("explorer-test");
  const name = () => {
    tests.forEach((test, at) => { choice.options[at].textContent = test.name[chosenUnits()]; });
  };
  tests.forEach((test, at) => choice.add(new Option("", at)));

  const unpacked = (text) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  };
  const show = (range, ...arrays) => {
    const values = arrays.flatMap((array) => Array.from(array)).filter((value) => !isNaN(value));
    const [low, high] = values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    const margin = 0.04 * (high - low) || 1;
    const [start, end] = [low - margin, high + margin];
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
    const [motion, response] = system.names;
    for (const along of ["x", "t"]) {
      const plot = model.get_model_by_name(`plot-${along}`);
      show(plot.x_range, data[along]);
      show(plot.y_range, data.lower, data.upper, data.force);
      plot.below[0].axis_label = system.labels[along];
      plot.left[0].axis_label = system.labels.y;
      model.get_model_by_name(`hover-${along}`).tooltips = [
        system.labels.t === "sample" ? ["sample", "@t{0}"] : ["time", "@t{0.000} s"],
        [motion, `@x{0.000[000]} ${system.length}`],
        [response, `@force{0.000} ${system.force}`],
        ["predicted", `@median{0.000} ${system.force} (@lower{0.000} to @upper{0.000})`],
        ["stage", "@stage"],
      ];
    }
    document.getElementById("explorer-role").textContent = test.fitted ? "fitted" : "held out";
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
