/** A line through points in space, of which the first are drawn: thick where a graphics card draws it. */

import * as three from "three";
import { Line2 } from "three/addons/lines/Line2.js";
import { LineGeometry } from "three/addons/lines/LineGeometry.js";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";

export class Path3d {
  readonly object: three.Object3D;
  private readonly thin: three.Line | null;
  private readonly thick: Line2 | null;

  /** @param wide width in pixels; 0 for the width that costs least */
  constructor(wide: number) {
    this.thin = wide ? null : new three.Line(new three.BufferGeometry(), new three.LineBasicMaterial());
    this.thick = wide ? new Line2(new LineGeometry(), new LineMaterial({ linewidth: wide })) : null;
    this.object = (this.thin ?? this.thick)!;
  }

  /** Draw it through points, in a colour; through none it is not drawn. */
  through(points: three.Vector3[], ink: string): void {
    this.object.visible = points.length > 1;
    if (this.thin) {
      this.thin.geometry.dispose();
      this.thin.geometry = new three.BufferGeometry().setFromPoints(points);
      (this.thin.material as three.LineBasicMaterial).color.set(ink);
    } else if (this.thick) {
      this.thick.geometry.dispose();
      this.thick.geometry = new LineGeometry();
      if (points.length > 1) this.thick.geometry.setPositions(points.flatMap((one) => [one.x, one.y, one.z]));
      this.thick.material.color.set(ink);
    }
  }

  /** Draw it up to a number of points. */
  upTo(points: number): void {
    this.thin?.geometry.setDrawRange(0, points);
    if (this.thick) this.thick.geometry.instanceCount = Math.max(points - 1, 0);
  }
}
