// Drawing: elements of SVG, axes, and marks.

const SVG = "http://www.w3.org/2000/svg";
let serial = 0;
const element = (name, attributes = {}, ...children) => {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
};
const text = (x, y, words, attributes = {}) => element("text", { x: round(x), y: round(y), ...attributes }, words);
const round = (value) => Math.round(value * 100) / 100;
const path = (d, kind, attributes = {}) => element("path", { d, class: kind, ...attributes });
const picture = (width, height, name, description) => {
  serial += 1;
  const title = element("title", { id: `title-${serial}` }, name);
  const more = element("desc", { id: `desc-${serial}` }, description);
  const svg = element("svg", {
    viewBox: `0 0 ${round(width)} ${round(height)}`,
    role: "img",
    "aria-labelledby": title.id,
    "aria-describedby": more.id,
  }, title, more);
  if (width < 420) svg.setAttribute("class", "small");
  return svg;
};
const scale = ([low, high], [from, to]) => {
  const factor = (to - from) / (high - low || 1);
  return (value) => round(from + (value - low) * factor);
};
const clipped = (svg, x, y, width, height) => {
  serial += 1;
  const clip = element("clipPath", { id: `clip-${serial}` }, element("rect", { x, y, width, height }));
  const inside = element("g", { "clip-path": `url(#clip-${serial})` });
  svg.append(clip, inside);
  return inside;
};
/** Axes with ticks; returns the scales and a group that is clipped to them. */
const axes = (svg, box, xRange, yRange, { xTicks, yTicks, xName = "", yName = "" }) => {
  const x = scale(xRange, [box.left, box.right]);
  const y = scale(yRange, [box.bottom, box.top]);
  let grid = "";
  for (const [value, words] of xTicks) {
    grid += `M${x(value)} ${box.top}V${box.bottom}`;
    svg.append(text(x(value), box.bottom + 15, words, { "text-anchor": "middle" }));
  }
  for (const [value, words] of yTicks) {
    grid += `M${box.left} ${y(value)}H${box.right}`;
    svg.append(text(box.left - 5, y(value) + 4, words, { "text-anchor": "end" }));
  }
  svg.append(path(grid || "M0 0", "grid"));
  if (xName) svg.append(text((box.left + box.right) / 2, box.bottom + 32, xName, { "text-anchor": "middle" }));
  if (yName) svg.append(text(box.left, box.top - 8, yName, { class: "strong" }));
  const inside = clipped(svg, box.left, box.top, box.right - box.left, box.bottom - box.top);
  svg.append(path(`M${box.left} ${box.top}H${box.right}V${box.bottom}H${box.left}Z`, "frame"));
  return { x, y, inside };
};
const dots = (points) => points.map(([x, y]) => `M${x} ${y}h0`).join("");
const circles = (points, radius) => points.map(([x, y]) => `M${round(x - radius)} ${y}a${radius} ${radius} 0 1 0 ${2 * radius} 0a${radius} ${radius} 0 1 0 ${-2 * radius} 0`).join("");
/** How wide each panel of a figure is that lays several side by side. */
const panelWidth = (holder, full) => {
  const style = getComputedStyle(holder);
  const columns = style.gridTemplateColumns.split(" ").length;
  return Math.floor((full - (columns - 1) * parseFloat(style.columnGap || "0")) / columns);
};
/** What a mark is called: the prior's are grey, dashed or hatched, the data's blue and solid. */
const kindOf = (kind, priors) => (priors ? `${kind} priors` : kind);
