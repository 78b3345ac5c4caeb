/** No two files import each other, not even for types: each can be read after those that it imports. */

import { expect, test } from "vitest";

const FILES = import.meta.glob<string>("../src/*.ts", { query: "?raw", import: "default", eager: true });

/** Files that a file imports, without their endings. */
function imports(name: string): string[] {
  const text = FILES[`../src/${name}.ts`] ?? "";
  return [...text.matchAll(/from "\.\/(\w+)"/g)].map((found) => found[1]!);
}

/** The first circle of imports below a file; empty if there is none. */
function circle(name: string, above: string[], free: Set<string>): string[] {
  if (above.includes(name)) return [...above.slice(above.indexOf(name)), name];
  if (free.has(name)) return [];
  for (const next of imports(name)) {
    const found = circle(next, [...above, name], free);
    if (found.length) return found;
  }
  free.add(name);
  return [];
}

test("no two files import each other", () => {
  expect(imports("main")).toContain("view");
  const names = Object.keys(FILES).map((file) => file.slice("../src/".length, -".ts".length));
  expect(names.length).toBeGreaterThan(30);
  const free = new Set<string>();
  for (const name of names) expect(circle(name, [], free)).toEqual([]);
});
