/**
 * Loads modules of the pages in Node.js.
 *
 * They are copied beside a package.json, because Node.js takes a lone `.js` for no ES module.
 */
import { cp, mkdtemp, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { after } from "node:test";

const STATIC = fileURLToPath(new URL("../../pipelines/seats/static", import.meta.url));
const folder = await mkdtemp(join(tmpdir(), "pages-"));
await cp(STATIC, folder, { recursive: true });
await writeFile(join(folder, "package.json"), '{"type": "module"}');
after(() => rm(folder, { recursive: true }));

let copies = 0;

/** @param {string} name As "wire.js". */
export const load = (name) => import(pathToFileURL(join(folder, name)).href);

/** Loads it anew, as a worker or a worklet that begins. @param {string} name */
export const begin = (name) => import(`${pathToFileURL(join(folder, name)).href}?${(copies += 1)}`);
