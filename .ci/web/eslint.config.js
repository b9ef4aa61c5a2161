import js from "@eslint/js";
import globals from "globals";

/** What holds in every module of the pages. */
const rules = {
  ...js.configs.recommended.rules,
  curly: ["error", "multi-line"],
  eqeqeq: "error",
  "no-alert": "error",
  "no-console": "error",
  "no-eval": "error",
  "no-implicit-globals": "error",
  "no-new-func": "error",
  "no-var": "error",
  "prefer-const": "error",
  "no-restricted-properties": [
    "error",
    { property: "innerHTML", message: "what a session sends is text, never markup: use textContent" },
    { property: "outerHTML", message: "what a session sends is text, never markup: use textContent" },
  ],
};

const files = (pattern, names) => ({
  files: [pattern],
  languageOptions: { ecmaVersion: "latest", sourceType: "module", globals: names },
  rules,
});

export default [
  files("**/*.js", globals.browser),
  files("**/*_worker.js", globals.worker),
  files("**/*_worklet.js", globals.audioWorklet),
];
