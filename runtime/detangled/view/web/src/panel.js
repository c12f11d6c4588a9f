// The controls beside the picture, and what is known of the hair.

import { HAIR, TYPES, TYPE_COLOURS, UNREAD, fromHex, rampCss, toHex } from "./colours.js";
import { size } from "./pick.js";

const BY = { hair: "Hair", type: "Type", radius: "Radius", wavelength: "Wavelength", twist: "Twist" };
const KEYS = [
  ["drag, arrows", "orbit"],
  ["wheel, pinch, + −", "zoom"],
  ["right drag, two fingers", "move"],
  ["click", "what a strand is"],
  ["1 to 5", "views"],
  ["0", "whole hair again"],
];
const PAIR_KEYS = [["[ ]", "move the divider"]];
const LAST_KEYS = [["L", "light or dark"]];

const byId = (id) => document.getElementById(id);

export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

export function heading(page) {
  document.title = page.title;
  byId("title").replaceChildren(...page.hairs.flatMap(({ name }, k) => (k ? [element("i", { textContent: " → " }), name] : [name])));
  byId("made").textContent = `detangled ${page.version}`;
  const keys = [...KEYS, ...(page.hairs.length > 1 ? PAIR_KEYS : []), ...LAST_KEYS];
  byId("keys").replaceChildren(
    ...keys.flatMap(([key, does]) => [element("dt", { textContent: key }), element("dd", { textContent: does })]),
  );
  if (page.hairs.length < 2) return;
  for (const [k, id, word] of [[0, "tag-before", "Before"], [1, "tag-after", "After"]]) {
    byId(id).hidden = false;
    byId(id).replaceChildren(element("b", { textContent: word }), ` ${page.hairs[k].name}`);
  }
}

// A row of buttons of which one is on; arrow keys go from one to the next.
function choices(container, names, initial, chosen) {
  const buttons = Object.entries(names).map(([value, text]) => {
    const button = element("button", { type: "button", textContent: text });
    button.dataset.value = value;
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => choose(value));
    return button;
  });
  function choose(value, silent = false) {
    for (const button of buttons) {
      const on = button.dataset.value === value;
      button.setAttribute("aria-checked", on);
      button.tabIndex = on || (!(value in names) && button === buttons[0]) ? 0 : -1;
    }
    if (!silent) chosen(value);
  }
  container.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    const at = buttons.indexOf(document.activeElement);
    if (!step || at < 0) return;
    event.preventDefault();
    const next = buttons[(at + step + buttons.length) % buttons.length];
    choose(next.dataset.value);
    next.focus();
  });
  container.append(...buttons);
  choose(initial, true);
  return choose;
}

export function viewButtons(views, look) {
  byId("views").append(
    ...views.map((name, k) => {
      const button = element("button", { type: "button", textContent: name, title: `${name === "¾" ? "Three quarters" : name} (${k + 1})` });
      button.addEventListener("click", () => look(name));
      return button;
    }),
  );
}

export function widthControl(natural, chosen) {
  const input = byId("width");
  const told = () => {
    const factor = 2 ** Number(input.value);
    const text = `${(10 * natural * factor).toPrecision(2)} mm`;
    byId("width-value").textContent = text;
    input.setAttribute("aria-valuetext", text);
    return factor;
  };
  input.addEventListener("input", () => chosen(told()));
  input.addEventListener("dblclick", () => {
    input.value = 0;
    chosen(told());
  });
  told();
}

export function colourControl(initial, chosen) {
  const container = byId("colours");
  const own = element("input", { type: "color", value: toHex(HAIR[initial]), title: "Another colour" });
  own.setAttribute("aria-label", "Another hair colour");
  const choose = choices(container, HAIR, initial, (name) => {
    byId("colour-value").textContent = name;
    own.value = toHex(HAIR[name]);
    chosen(HAIR[name]);
  });
  for (const button of container.querySelectorAll("button")) {
    const name = button.dataset.value;
    button.textContent = "";
    button.title = name;
    button.setAttribute("aria-label", name);
    button.style.background = toHex(HAIR[name]);
  }
  byId("colour-value").textContent = initial;
  own.addEventListener("input", () => {
    choose("", true);
    byId("colour-value").textContent = own.value;
    chosen(fromHex(own.value));
  });
  container.append(own);
}

export function labelControl(labelled, chosen) {
  if (!labelled) {
    byId("label-section").hidden = true;
    return () => {};
  }
  return choices(byId("by"), BY, "hair", chosen);
}

// What the colours mean; the types can be shown and hidden. counts: strands of each type, and last of those not read.
export function legend(by, range, counts, hidden, toggled) {
  const box = byId("legend");
  if (by === "hair") return box.replaceChildren();
  if (by !== "type") {
    if (!range) return box.replaceChildren(element("p", { textContent: "No strand has one." }));
    const ramp = element("div", { className: "ramp" });
    ramp.style.background = rampCss;
    const middle = by === "twist" ? 0.5 : Math.sqrt(range[0] * range[1]);
    const unit = by === "twist" ? "" : " cm";
    const grey = element("p", { className: "small", textContent: `Grey: ${by === "twist" ? "" : "straight, or "}not read.` });
    const ends = [range[0], middle, range[1]].map((value) => element("span", { textContent: `${size(value)}${unit}` }));
    box.replaceChildren(ramp, element("div", { className: "ends" }, ...ends), grey);
    return;
  }
  const names = [...TYPES, "not read"];
  const chips = names.flatMap((name, k) => {
    if (!counts[k]) return [];
    const value = k < TYPES.length ? k : 255;
    const dot = element("i");
    dot.style.background = TYPE_COLOURS[k] || UNREAD;
    const chip = element("button", { type: "button", className: "chip", title: "Show or hide these strands" }, dot, name);
    chip.setAttribute("aria-pressed", !hidden.has(value));
    chip.addEventListener("click", () => {
      toggled(value);
      chip.setAttribute("aria-pressed", !hidden.has(value));
    });
    return [chip];
  });
  box.replaceChildren(element("div", { className: "row" }, ...chips));
}

export function factsOf(page) {
  const box = byId("facts");
  const { hairs } = page;
  const heads = hairs.length > 1 ? ["Before", "After"] : [""];
  box.append(element("h2", { textContent: "What this hair is" }));
  for (const [k, { facts }] of hairs.entries()) {
    if (!facts?.called) continue;
    const said = element("p", { className: "called" });
    if (heads[k]) said.append(element("b", { textContent: `${heads[k]} ` }));
    said.append(facts.called);
    box.append(said);
  }
  const labelled = hairs.some(({ facts }) => facts);
  const rows = [["strands", hairs.map(({ strands }) => strands.toLocaleString("en"))]];
  if (labelled) rows.push(["curled", hairs.map(({ facts }) => (facts ? percent(facts.readings.read / facts.strands) : "–"))]);
  rows.push(["points", hairs.map(({ pointCount }) => pointCount.toLocaleString("en"))]);
  if (labelled) {
    for (const [name, key] of [["length, cm", "length_cm"], ["radius, cm", "radius_cm"], ["wavelength, cm", "wavelength_cm"], ["twist", "twist"]]) {
      rows.push([name, hairs.map(({ facts }) => (facts && tells(facts, key) ? spread(facts[key]) : "–"))]);
    }
  }
  const table = element("table");
  if (hairs.length > 1) {
    table.append(element("thead", {}, element("tr", {}, element("td"), ...heads.map((text) => element("th", { scope: "col", textContent: text })))));
  }
  table.append(
    element(
      "tbody",
      {},
      ...rows.map(([name, cells]) =>
        element("tr", {}, element("th", { scope: "row", textContent: name }), ...cells.map((cell) => element("td", {}, ...[cell].flat()))),
      ),
    ),
  );
  box.append(table);
  if (labelled) {
    box.append(element("p", { className: "small", textContent: "Median, and the middle 80 % of strands; radius, wavelength and twist of curled strands." }), typeBars(hairs, heads));
  } else box.append(element("p", { className: "small", textContent: "Strands were not labelled." }));
  const caveats = [...new Set(hairs.flatMap(({ facts }) => facts?.caveats || []))];
  for (const text of [...caveats, ...hairs.flatMap(({ notes }) => notes)]) {
    box.append(element("p", { className: "small", textContent: sentence(text) }));
  }
}

// Some is never shown as none, nor most as all.
function percent(share) {
  if (share > 0 && share < 0.005) return "<1 %";
  if (share >= 0.995 && share < 1) return ">99 %";
  return `${Math.round(100 * share)} %`;
}

// Radius, wavelength and twist are those of curled strands: of a few among many they would describe the wrong hair.
const tells = (facts, key) => key === "length_cm" || facts.readings.read >= 0.01 * facts.strands;

const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}`;

function spread(values) {
  if (!values) return "–";
  return [size(values.median), element("small", { textContent: `${size(values.p10)} – ${size(values.p90)}` })];
}

function typeBars(hairs, heads) {
  const bars = element("div", { className: "bars" });
  for (const [k, type] of TYPES.entries()) {
    const shares = hairs.map(({ facts }) => facts?.types[type].share || 0);
    if (!shares.some((share) => share > 0)) continue;
    const walker = hairs.find(({ facts }) => facts).facts.types[type].walker;
    const stack = element("div", { className: "stack" });
    for (const [h, share] of shares.entries()) {
      const bar = element("div", { className: "bar", title: `${heads[h]} ${percent(share)}`.trim() });
      bar.style.width = `${Math.max(100 * share, share > 0 ? 1 : 0)}%`;
      bar.style.background = TYPE_COLOURS[k];
      bar.style.opacity = heads.length > 1 && h === 0 ? 0.45 : 1;
      stack.append(bar);
    }
    const told = element("span", { className: "share", textContent: shares.map(percent).join(" → ") });
    bars.append(element("span", { textContent: type }, element("small", { textContent: ` ${walker}` })), stack, told);
  }
  return bars;
}
