import { defineConfig } from "vite";

export default defineConfig({
  build: { outDir: "../src/threadline/panel/page", emptyOutDir: true, assetsInlineLimit: 0, chunkSizeWarningLimit: 800 },
});
