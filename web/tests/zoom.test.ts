import { expect, it } from "vitest";
import { Zoom } from "../src/zoom";

const place = () =>
  ({ addEventListener: () => {}, style: {}, clientWidth: 200, clientHeight: 100 }) as unknown as HTMLElement;

it("sees all of a work at first and at most, and no place beyond it", () => {
  let drawn = 0;
  const zoom = new Zoom(place(), () => drawn++);
  expect([zoom.seen(0, 200, "x"), zoom.seen(200, 200, "x")]).toEqual([0, 200]);
  zoom.by(2);
  expect([zoom.seen(50, 200, "x"), zoom.seen(150, 200, "x")]).toEqual([0, 200]);
  zoom.moveBy(5, -5); // to the right end, and to the top
  expect([zoom.seen(100, 200, "x"), zoom.seen(200, 200, "x")]).toEqual([0, 200]);
  expect([zoom.seen(0, 100, "y"), zoom.seen(50, 100, "y")]).toEqual([0, 100]);
  zoom.by(0.1);
  expect([zoom.factor, zoom.seen(0, 200, "x")]).toEqual([1, 0]);
  zoom.by(1e9);
  expect(zoom.factor).toBe(40);
  zoom.by(0);
  expect(zoom.seen(200, 200, "x")).toBe(200);
  expect(drawn).toBeGreaterThan(4);
});
