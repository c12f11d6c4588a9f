// Camera, wipe and drawing: only when something changed, with fewer and wider strands while it moves on slow machines.

import { MathUtils, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const FIELD_OF_VIEW = 26; // degrees over the shorter side, as pictures have it: a portrait lens
const MARGIN = 0.06;
const SLOW_MS = 45; // a frame beyond it draws fewer strands next time
const QUICK_MS = 22;
const FEWEST = 0.02; // of the strands
const FLUENT = 1_500_000; // segments that most machines turn without a hitch
const STILL_MS = 140; // after which all strands are drawn again
const TURN = Math.PI / 18; // by one press of an arrow key

// Azimuth and elevation of the viewer [degrees], counted from the front.
export const VIEWS = { "¾": [40, 14], Front: [0, 0], Side: [90, 0], Back: [180, 0], Top: [0, 89.9] };

// In viewer's axes: a high key from the left in front, a rim from the right behind.
const KEY = new Vector3(-0.45, 0.68, 0.58).normalize();
const RIM = new Vector3(0.62, 0.48, -0.62).normalize();

export class Stage {
  // cloud: (N x 3) points [cm] that a view must show.
  constructor(canvas, cloud, radius) {
    this.canvas = canvas;
    this.cloud = cloud;
    this.radius = radius;
    this.sides = []; // for each hair: its scene and what was drawn (see hair.js)
    this.split = 0.5;
    this.widthFactor = 1;
    this.fraction = 1;
    this.moving = false;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.renderer.autoClear = false;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 1000);
    this.shared = {
      eye: { value: this.camera.position },
      width: { value: 1 },
      pixel: { value: 1 },
      gloss: { value: 1 },
      key: { value: new Vector3() },
      rim: { value: new Vector3() },
    };
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.controls.minDistance = 0.02 * radius;
    this.controls.maxDistance = 40 * radius;
    this.controls.addEventListener("change", () => this.moved());
    canvas.addEventListener("webglcontextrestored", () => this.moved());
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
  }

  add(drawn, width) {
    const scene = new Scene();
    scene.add(...drawn.meshes);
    this.naturalWidth = width;
    this.sides.push({ scene, drawn });
    this.fraction = Math.min(this.fraction, FLUENT / drawn.segments);
    return scene;
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    if (!clientWidth || !clientHeight) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    const narrow = Math.tan(MathUtils.degToRad(FIELD_OF_VIEW / 2)) / Math.min(1, this.camera.aspect);
    this.camera.fov = 2 * MathUtils.radToDeg(Math.atan(narrow));
    this.camera.updateProjectionMatrix();
    if (this.view && !this.turned) this.look(this.view);
    this.changed();
  }

  // The nearest place from which everything is seen, from one of VIEWS.
  look(view) {
    this.view = view;
    const [azimuth, elevation] = VIEWS[view].map(MathUtils.degToRad);
    const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
    const right = new Vector3(ca, 0, -sa);
    const up = new Vector3(-se * sa, ce, -se * ca);
    const back = new Vector3(ce * sa, se, ce * ca);
    const high = (1 - 2 * MARGIN) * Math.tan(MathUtils.degToRad(this.camera.fov / 2));
    const slopes = [high * this.camera.aspect, high];
    // Each point bounds the eye's place by a plane on each side of the frustum.
    const bounds = [-Infinity, -Infinity, -Infinity, -Infinity];
    let [near, deep] = [-Infinity, Infinity];
    const point = new Vector3();
    for (let i = 0; i < this.cloud.length; i += 3) {
      point.fromArray(this.cloud, i);
      const z = point.dot(back);
      near = Math.max(near, z);
      deep = Math.min(deep, z);
      for (const [k, axis] of [right, up].entries()) {
        const across = point.dot(axis);
        bounds[2 * k] = Math.max(bounds[2 * k], across + slopes[k] * z);
        bounds[2 * k + 1] = Math.max(bounds[2 * k + 1], -across + slopes[k] * z);
      }
    }
    const middle = 0.5 * (near + deep);
    let distance = near - middle + 0.1 * this.radius;
    for (const k of [0, 1]) {
      distance = Math.max(distance, (bounds[2 * k] + bounds[2 * k + 1]) / (2 * slopes[k]) - middle);
    }
    const target = this.controls.target;
    target.copy(right).multiplyScalar(0.5 * (bounds[0] - bounds[1]));
    target.addScaledVector(up, 0.5 * (bounds[2] - bounds[3])).addScaledVector(back, middle);
    this.camera.position.copy(target).addScaledVector(back, distance);
    this.controls.update();
    this.turned = false;
    this.moved();
    this.turned = false;
  }

  turn(right, up) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const flat = Math.hypot(offset.x, offset.z);
    const azimuth = Math.atan2(offset.x, offset.z) - right * TURN;
    const polar = Math.atan2(flat, offset.y) + up * TURN;
    offset.setFromSphericalCoords(offset.length(), Math.max(1e-3, Math.min(Math.PI - 1e-3, polar)), azimuth);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.moved();
  }

  zoom(factor) {
    this.camera.position.sub(this.controls.target).multiplyScalar(factor).add(this.controls.target);
    this.controls.update();
    this.moved();
  }

  // The view, or the wipe, is on its way somewhere.
  moved() {
    this.moving = true;
    this.turned = true;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.moving = false;
      this.changed();
    }, STILL_MS);
    this.changed();
  }

  // Something else is to be drawn; waits for the next frame.
  changed() {
    this.onChanged?.();
    if (this.frame) return;
    this.frame = requestAnimationFrame((now) => {
      this.frame = 0;
      if (this.moving && this.lastWasMoving) this.pace(now - this.last);
      this.last = now;
      this.lastWasMoving = this.moving;
      this.draw();
    });
  }

  pace(milliseconds) {
    if (milliseconds > SLOW_MS) this.fraction = Math.max(FEWEST, (this.fraction * 30) / milliseconds);
    else if (milliseconds < QUICK_MS) this.fraction = Math.min(1, 1.15 * this.fraction);
  }

  draw() {
    if (!this.sides.length) return;
    const { camera, renderer, shared } = this;
    const distance = camera.position.length();
    camera.near = Math.max(distance - 1.2 * this.radius, 0.004 * this.radius);
    camera.far = distance + 1.2 * this.radius;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    shared.key.value.copy(KEY).transformDirection(camera.matrixWorld);
    shared.rim.value.copy(RIM).transformDirection(camera.matrixWorld);
    const fraction = this.moving ? this.fraction : 1;
    shared.width.value = (this.naturalWidth * this.widthFactor) / Math.sqrt(fraction);
    const [width, height] = [this.canvas.width, this.canvas.height];
    shared.pixel.value = (2 * Math.tan(MathUtils.degToRad(camera.fov / 2))) / height;
    const scale = 1 / (shared.pixel.value * camera.position.distanceTo(this.controls.target));
    renderer.setScissorTest(false);
    renderer.clear();
    renderer.setScissorTest(true);
    const ratio = renderer.getPixelRatio();
    const edge = this.sides.length > 1 ? Math.round(this.split * width) : width;
    for (const [k, { scene, drawn }] of this.sides.entries()) {
      const [from, to] = k === 0 ? [0, edge] : [edge, width];
      if (to <= from) continue;
      drawn.show(fraction, scale);
      renderer.setScissor(from / ratio, 0, (to - from) / ratio, height / ratio);
      renderer.render(scene, camera);
    }
    this.onDrawn?.();
  }
}
