import { gzipSync } from "node:zlib";
import { defineConfig } from "vite";

/** Write each script and style a second time, compressed: the server sends that where it is taken. */
const compressed = {
  name: "compressed",
  generateBundle(
    this: { emitFile(file: { type: "asset"; fileName: string; source: Uint8Array }): string },
    _: unknown,
    bundle: Record<string, { type: "chunk"; code: string } | { type: "asset"; source: string | Uint8Array }>,
  ) {
    for (const [name, one] of Object.entries(bundle)) {
      const content = one.type === "chunk" ? one.code : one.source;
      const source = gzipSync(content, { level: 9 });
      if (name.startsWith("assets/")) this.emitFile({ type: "asset", fileName: `${name}.gz`, source });
    }
  },
};

export default defineConfig({
  build: {
    outDir: "../src/threadline/panel/page",
    emptyOutDir: true,
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 800,
  },
  plugins: [compressed],
});
