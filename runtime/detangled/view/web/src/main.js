// The page: reads what it carries, draws it, and joins the controls to the picture.

import { HAIR, TYPES, rangeOf, strandColours } from "./colours.js";
import { drawnHair, openHair, place } from "./hair.js";
import { drawnHead, openHead } from "./head.js";
import * as panel from "./panel.js";
import { strandAt, strandWords } from "./pick.js";
import { Stage, VIEWS } from "./stage.js";
import { wipe } from "./wipe.js";

const CLOUD = 20_000; // points that views are framed by, of each hair
const COLOUR = "Dark brown";
const CLICK_PX = 4; // a pointer that moved less has clicked

const root = document.documentElement;
const byId = (id) => document.getElementById(id);

function cloudOf(hairs, head) {
  const cloud = [];
  for (const hair of hairs) {
    const total = hair.points.length / 3;
    const every = Math.max(1, Math.floor(total / CLOUD));
    for (let i = 0; i < total; i += every) cloud.push(...place(hair, i, []));
  }
  if (head) {
    const position = head.getAttribute("position").array;
    for (let i = 0; i < position.length; i += 3) cloud.push(position[i], position[i + 1], position[i + 2]);
  }
  return cloud;
}

function themed(page) {
  const set = (theme) => {
    root.dataset.theme = theme;
    byId("theme").setAttribute("aria-label", `${theme === "dark" ? "Light" : "Dark"} background`);
  };
  const flip = () => set(root.dataset.theme === "dark" ? "light" : "dark");
  set(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  byId("theme").addEventListener("click", flip);
  return flip;
}

function firstCheck() {
  if (typeof DecompressionStream === "undefined") throw new Error("This browser is too old: it cannot unpack the hair.");
  if (!document.createElement("canvas").getContext("webgl2")) {
    throw new Error("This browser offers no WebGL 2, which draws the hair. Try another, or allow hardware acceleration.");
  }
}

async function start() {
  const page = JSON.parse(byId("page").textContent);
  panel.heading(page);
  panel.factsOf(page);
  const flip = themed(page);
  firstCheck();
  const centre = page.low.map((low, c) => 0.5 * (low + page.high[c]));
  const extent = Math.max(...page.low.map((low, c) => page.high[c] - low));
  const hairs = [];
  for (const about of page.hairs) hairs.push(await openHair(about, centre));
  const head = page.head && (await openHead(page.head, centre));
  const cloud = cloudOf(hairs, head);
  let radius = 0;
  for (let i = 0; i < cloud.length; i += 3) radius = Math.max(radius, Math.hypot(cloud[i], cloud[i + 1], cloud[i + 2]));

  const stage = new Stage(byId("hair"), cloud, radius);
  stage.onChanged = () => (root.dataset.state = "drawing");
  stage.onDrawn = () => {
    byId("message").hidden = true;
    if (!stage.moving) root.dataset.state = "ready";
  };
  const drawn = hairs.map((hair) => drawnHair(hair, stage.shared, page.width, extent, Boolean(head)));
  const heads = drawn.map((each) => {
    const scene = stage.add(each, page.width);
    if (!head) return null;
    const mesh = drawnHead(head, each.grid, stage.shared);
    scene.add(mesh);
    return mesh;
  });

  const state = { by: "hair", colour: HAIR[COLOUR], hidden: new Set() };
  let colours = [];
  let picked = [-1, -1]; // hair, strand
  const labelled = hairs.some(({ labels }) => labels);
  const walker = {};
  for (const { facts } of page.hairs) for (const type of TYPES) walker[type] ??= facts?.types[type].walker;
  const range = () => (["hair", "type"].includes(state.by) ? null : rangeOf(hairs.filter(({ labels }) => labels), state.by));

  function paint() {
    stage.shared.gloss.value = state.by === "hair" ? 1 : 0.25;
    const span = range();
    colours = hairs.map((hair, k) => strandColours(hair, { ...state, picked: picked[0] === k ? picked[1] : -1 }, span));
    drawn.forEach((each, k) => each.paint(colours[k]));
    stage.changed();
  }
  function pick(k, strand) {
    picked = [k, strand];
    byId("picked").hidden = strand < 0;
    if (strand >= 0) byId("picked").textContent = strandWords(hairs[k], strand, walker);
    paint();
  }
  function counts() {
    const sums = new Array(TYPES.length + 1).fill(0);
    for (const { labels } of hairs) for (const type of labels?.type || []) sums[Math.min(type, TYPES.length)]++;
    return sums;
  }
  function by(name) {
    state.by = name;
    if (name !== "type") state.hidden.clear();
    panel.legend(name, range(), counts(), state.hidden, (type) => {
      if (!state.hidden.delete(type)) state.hidden.add(type);
      paint();
    });
    paint();
  }

  const setBy = panel.labelControl(labelled, by);
  panel.viewButtons(Object.keys(VIEWS), (name) => stage.look(name));
  panel.widthControl(page.width, (factor) => {
    stage.widthFactor = factor;
    stage.changed();
  });
  panel.colourControl(COLOUR, (colour) => {
    state.colour = colour;
    setBy("hair");
    by("hair");
  });
  if (head) {
    byId("head-row").hidden = false;
    byId("head").addEventListener("change", (event) => {
      for (const mesh of heads) mesh.visible = event.target.checked;
      stage.changed();
    });
  }
  const divider = hairs.length > 1 && wipe(byId("wipe"), stage, (split) => {
    byId("tag-before").classList.toggle("away", split < 0.02);
    byId("tag-after").classList.toggle("away", split > 0.98);
  });

  let pressed = null;
  stage.canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  stage.canvas.addEventListener("pointerup", (event) => {
    if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > CLICK_PX) return;
    const box = stage.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    const k = hairs.length > 1 && x > stage.split * box.width ? 1 : 0;
    pick(k, strandAt(hairs[k], colours[k], stage.camera, stage.canvas, x, y));
  });
  stage.canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    byId("message").hidden = false;
    byId("message").textContent = "The graphics card took the picture away. Reload the page if it does not come back.";
  });

  const views = Object.keys(VIEWS);
  const keys = {
    "+": () => stage.zoom(0.87),
    "=": () => stage.zoom(0.87),
    "-": () => stage.zoom(1.15),
    0: () => stage.look(stage.view),
    l: flip,
    L: flip,
    "[": () => divider && divider.left(),
    "]": () => divider && divider.right(),
    Escape: () => pick(-1, -1),
    ...Object.fromEntries(views.map((name, k) => [k + 1, () => stage.look(name)])),
  };
  const arrows = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input")) return;
    if (event.target === stage.canvas && arrows[event.key]) {
      stage.turn(...arrows[event.key]);
      event.preventDefault();
    } else keys[event.key]?.();
  });
  stage.canvas.setAttribute("aria-label", `${page.title}, in three dimensions. Arrow keys turn it, plus and minus zoom.`);

  paint();
  stage.look(views[0]);
}

start().catch((error) => {
  root.dataset.state = "failed";
  byId("message").textContent = error.message;
  byId("message").hidden = false;
  console.error(error);
});
