// Tables and legends: everything is put in as text.

const cell = (tag, words, attributes = {}) => {
  const made = document.createElement(tag);
  made.textContent = words;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
};
/** A table in a box that scrolls by itself; of each row the first cell is its heading. */
const tableOf = (caption, names, rows) => {
  const table = document.createElement("table");
  const head = document.createElement("thead");
  const heading = document.createElement("tr");
  names.forEach((words, k) => heading.append(cell("th", words, { scope: "col", ...(k ? { class: "n" } : {}) })));
  head.append(heading);
  const body = document.createElement("tbody");
  rows.forEach(([name, ...words]) => {
    const line = document.createElement("tr");
    line.append(cell("th", name, { scope: "row" }), ...words.map((word) => cell("td", word, { class: "n" })));
    body.append(line);
  });
  table.append(cell("caption", caption), head, body);
  const box = document.createElement("div");
  for (const [name, value] of [["class", "scroll"], ["tabindex", "0"], ["role", "region"], ["aria-label", caption]]) box.setAttribute(name, value);
  box.append(table);
  return box;
};
const key = (kind, words) => {
  const span = document.createElement("span");
  span.className = "key";
  const swatch = document.createElement("span");
  swatch.className = `swatch ${kind}`;
  swatch.setAttribute("aria-hidden", "true");
  span.append(swatch, words);
  return span;
};
const withInterval = (middle, low, high, priors = false) =>
  (Number.isFinite(middle) && middle !== null ? `${written(middle)}${priors ? "*" : ""} (${written(low)} to ${written(high)})` : "–");
