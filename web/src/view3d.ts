/** View of mandrel or bed and path in three dimensions: planned, simulated, live. */

import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { by, put, tell, value } from "./dom";
import type { Figures, Mandrel, State } from "./messages";
import { bySoftware, onScreen } from "./seen";

const SHOWN_S = 15; // longest playing time of a simulation, s
const GREY = 0xbdbdbd, FAINT = 0x8f8f8f, BLUE = 0x003f72, INK = 0x949494, DARK = 0x333333;

type At = Record<string, number>;

export class View3d {
  private readonly renderer: three.WebGLRenderer;
  private readonly scene = new three.Scene();
  private readonly camera = new three.PerspectiveCamera(35, 1.6, 0.001, 100);
  private readonly controls: OrbitControls;
  private readonly product = new three.Group(); // turns with the mandrel
  private readonly head = new three.Mesh(new three.ConeGeometry(1, 3, 16), new three.MeshLambertMaterial({ color: DARK }));
  private readonly done = new three.Line(new three.BufferGeometry(), new three.LineBasicMaterial({ color: BLUE }));
  private figures: Figures | null = null;
  private mandrel: Mandrel | null = null;
  private size = 0.1; // m
  private playing: number | null = null; // start of the simulation by the page's clock, ms
  private dirty = true;
  private shown = ""; // the state last drawn
  private readonly seen: () => boolean;
  /** Whether the processor draws: then without smoothed edges, and fewer frames. */
  readonly slow = bySoftware();

  constructor(private readonly place: HTMLElement, private readonly moves: () => boolean) {
    this.renderer = new three.WebGLRenderer({ antialias: !this.slow });
    this.renderer.setClearColor(0xe6e6e6);
    place.append(this.renderer.domElement);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => { this.dirty = true; });
    const lamp = new three.DirectionalLight(0xffffff, 1.6);
    lamp.position.set(-1, -2, 3);
    this.scene.add(new three.AmbientLight(0xffffff, 1.4), lamp, this.product, this.head);
    new ResizeObserver(() => this.fit()).observe(place);
    by("simulate").onclick = () => { this.playing = this.playing === null && this.figures && !moves() ? performance.now() : null; };
    by<HTMLSelectElement>("seen-from").onchange = () => this.look();
    this.seen = onScreen(place);
  }

  build(mandrel: Mandrel | null): void {
    if (!this.figures) this.show(null, mandrel);
  }

  /** Show the planned path; without figures the bare machine. */
  show(figures: Figures | null, mandrel: Mandrel | null): void {
    this.figures = figures;
    this.mandrel = mandrel;
    this.playing = null;
    this.shown = "";
    this.product.clear();
    this.done.geometry.dispose();
    this.done.geometry = new three.BufferGeometry();
    const points = figures ? figures.times_s.map((_, k) => this.onProduct(this.planned(k))) : [];
    const box = new three.Box3().setFromPoints(points.length ? points : [new three.Vector3(-0.1, -0.1, 0), new three.Vector3(0.1, 0.1, 0)]);
    if (mandrel) this.product.add(this.body(mandrel, box));
    else this.product.add(this.bed(box));
    if (points.length) {
      this.product.add(new three.Line(new three.BufferGeometry().setFromPoints(points), new three.LineBasicMaterial({ color: INK })));
      this.done.position.set(0, 0, mandrel ? 0 : this.size / 500);
      this.done.scale.set(1, ...(mandrel ? [1.004, 1.004] : [1, 1]) as [number, number]);
      this.done.geometry.setFromPoints(points);
      this.product.add(this.done);
    }
    this.size = Math.max(box.getSize(new three.Vector3()).length(), mandrel ? 2 * Math.max(...mandrel.radius) : 0, 0.01);
    this.head.scale.setScalar(this.size / 60);
    this.look();
    this.put(figures ? this.planned(0) : {}, 0);
  }

  /** Show the live position of the machine. */
  live(state: State): void {
    if (this.playing !== null && !this.moves()) return;
    this.playing = null;
    const at: At = {};
    for (const [name, where] of Object.entries(state.axes)) at[name] = where.measured ?? where.load ?? where.commanded ?? 0;
    const run = state.progress?.ended === null ? state.progress : null; // the run's time does not advance in a hold
    this.put(at, run ? this.step(run.time_s) : 0);
    tell("seen", this.moves() ? "the machine, now" : "the machine, at rest");
  }

  private planned(k: number): At {
    const at: At = {};
    for (const [name, places] of Object.entries(this.figures?.planned ?? {})) at[name] = places[k] ?? 0;
    return at;
  }

  /** Index of the planned point at a time. */
  private step(time_s: number): number {
    const times = this.figures?.times_s ?? [], later = times.findIndex((t) => t > time_s);
    return later < 0 ? times.length - 1 : Math.max(later - 1, 0);
  }

  private radius(along: number): number {
    const { at, radius } = this.mandrel!;
    const next = at.findIndex((place) => place > along);
    if (next <= 0) return next === 0 ? radius[0]! : radius[radius.length - 1]!;
    const share = (along - at[next - 1]!) / (at[next]! - at[next - 1]!);
    return radius[next - 1]! + share * (radius[next]! - radius[next - 1]!);
  }

  private onProduct(at: At): three.Vector3 {
    if (!this.mandrel) return new three.Vector3(at.X ?? 0, at.Y ?? 0, at.Z ?? 0);
    const along = at[this.mandrel.along] ?? 0, turn = at[this.mandrel.axis] ?? 0, radius = this.radius(along) * 1.002;
    return new three.Vector3(along, -radius * Math.sin(turn), radius * Math.cos(turn));
  }

  private body(mandrel: Mandrel, box: three.Box3): three.Object3D {
    const low = Math.min(box.min.x, mandrel.at[0] ?? 0) - 0.02, high = Math.max(box.max.x, mandrel.at[mandrel.at.length - 1] ?? 0) + 0.02;
    const places = [low, ...mandrel.at.filter((place) => place > low && place < high), high];
    const lathe = new three.LatheGeometry(places.map((place) => new three.Vector2(this.radius(place), place)), 48);
    const found = new three.Mesh(lathe, new three.MeshLambertMaterial({ color: GREY, side: three.DoubleSide }));
    found.rotation.z = -Math.PI / 2; // from y, the axis of a lathe geometry, to x
    return found;
  }

  private bed(box: three.Box3): three.Object3D {
    const size = box.getSize(new three.Vector3()), middle = box.getCenter(new three.Vector3());
    const side = Math.max(size.x, size.y, 0.01) * 1.2, found = new three.GridHelper(side, 12, FAINT, 0xcfcfcf);
    found.rotation.x = Math.PI / 2;
    found.position.set(middle.x, middle.y, Math.min(box.min.z, 0));
    return found;
  }

  private look(): void {
    const far = this.size * 1.7, [x, y, z] = { front: [0, -1, 0.05], above: [0, -0.02, 1], corner: [-0.55, -0.9, 0.6] }[value("seen-from")] ?? [0, -1, 0];
    const middle = new three.Box3().setFromObject(this.product).getCenter(new three.Vector3());
    this.controls.target.copy(middle);
    this.camera.position.copy(middle).add(new three.Vector3(x, y, z).multiplyScalar(far));
    this.controls.update();
    this.dirty = true;
  }

  /** Turn the product, place the head, and mark the first points of the path as done. */
  private put(at: At, points: number): void {
    const shown = JSON.stringify([at, points]);
    if (shown === this.shown) return; // nothing is drawn again at rest
    this.shown = shown;
    if (this.mandrel) {
      const along = at[this.mandrel.along] ?? 0;
      this.product.rotation.x = at[this.mandrel.axis] ?? 0;
      this.head.position.set(along, 0, this.radius(along) + this.size / 20);
    } else this.head.position.copy(this.onProduct(at)).add(new three.Vector3(0, 0, this.size / 40));
    this.head.rotation.x = -Math.PI / 2;
    this.done.geometry.setDrawRange(0, points);
    this.dirty = true;
  }

  private fit(): void {
    const width = Math.max(this.place.clientWidth, 200), height = Math.round(width * 0.56);
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

  draw(): void {
    const figures = this.figures;
    put(by<HTMLButtonElement>("simulate"), "disabled", figures === null || this.moves());
    tell("simulate", this.playing === null ? "Simulate" : "End simulation");
    if (this.playing !== null && figures) {
      const pace = Math.max(figures.duration_s / SHOWN_S, 1), time_s = pace * (performance.now() - this.playing) / 1000, k = this.step(time_s);
      this.put(this.planned(k), k + 1);
      tell("seen", `SIMULATED, not the machine: ${Math.min(time_s, figures.duration_s).toFixed(1)} of ${figures.duration_s.toFixed(1)} s, ${pace.toFixed(1)} times as fast`);
      if (time_s > figures.duration_s + 1) this.playing = null;
    }
    if (!this.dirty || !this.seen()) return;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
    this.place.dataset.drawn = String(Number(this.place.dataset.drawn ?? 0) + 1);
  }
}
