/**
 * Print as JSON what each function of scripts takes and gives back, and the comment above it.
 *
 * Run by tests/app/test_script_docs.py as `node --expose-internals script_functions.js FILE...`; the parser is the
 * acorn that node itself uses for its prompt.
 *
 * A function here is one with a name of its own: a declaration, also one within another function, a method, an
 * accessor, and an arrow function that a constant of the file or a field of a class holds.
 */

"use strict";

const { readFileSync } = require("node:fs");
const { parse } = require("internal/deps/acorn/acorn/dist/acorn");

const FUNCTIONS = ["FunctionDeclaration", "FunctionExpression", "ArrowFunctionExpression"];

/**
 * What a signature says of a parameter, or of a field of one that is taken apart.
 * @param {object} node parameter in the syntax tree
 * @returns {{name: string, optional: boolean, fields: object[]}} the name is empty where the parameter is taken apart
 */
function parameter(node) {
  if (node.type === "AssignmentPattern") return { ...parameter(node.left), optional: true };
  if (node.type === "RestElement") return parameter(node.argument);
  if (node.type === "Identifier") return { name: node.name, optional: false, fields: [] };
  if (node.type === "ArrayPattern") return { name: "", optional: false, fields: [] };
  const fields = node.properties.map((one) => {
    const held = one.type === "RestElement" ? one.argument : one.value;
    return { name: (one.key ?? held).name, optional: held.type === "AssignmentPattern" };
  });
  return { name: "", optional: false, fields };
}

/**
 * All nodes within a node of the syntax tree.
 * @param {object} node where to look
 * @param {(child: object) => boolean} [enters] tells whether what a node holds is looked at, too
 * @returns {Generator<object>} in the order of the text
 */
function* within(node, enters = () => true) {
  for (const child of Object.values(node).flat()) {
    if (!child || typeof child.type !== "string") continue;
    yield child;
    if (enters(child)) yield* within(child, enters);
  }
}

/**
 * Tell whether a function gives something back: a value, or a promise of one.
 * @param {object} node function in the syntax tree
 * @returns {boolean} false where every `return` stands alone
 */
function returns(node) {
  if (node.body.type !== "BlockStatement") return true;
  const own = within(node.body, (child) => !FUNCTIONS.includes(child.type));
  return [...own].some((child) => child.type === "ReturnStatement" && child.argument);
}

/**
 * Functions of one file, in its order.
 * @param {string} path file to read
 * @returns {object[]} of each: file, line, name, parameters, whether it returns, comment or null
 */
function functionsOf(path) {
  const text = readFileSync(path, "utf-8");
  const comments = [];
  const tree = parse(text, { ecmaVersion: "latest", sourceType: "module", locations: true, onComment: comments });
  const listed = [];
  const list = (name, node, whole) => {
    const above = comments.filter((one) => one.end <= whole.start).at(-1);
    const touches = above && !text.slice(above.end, whole.start).trim();
    const comment = touches && above.type === "Block" && above.value.startsWith("*") ? above.value : null;
    const parameters = node.params.map(parameter);
    listed.push({ file: path, line: whole.loc.start.line, name, parameters, returns: returns(node), comment });
  };
  const ofClass = (node) => {
    for (const member of node.body.body) {
      const held = member.value;
      if (!held || !FUNCTIONS.includes(held.type)) continue;
      const kind = ["get", "set"].includes(member.kind) ? `${member.kind} ` : "";
      list(`${node.id.name}.${kind}${member.key.name}`, held, member);
    }
  };
  const exported = new Map();
  for (const node of within(tree)) {
    if (node.type === "ExportNamedDeclaration") exported.set(node.declaration, node);
    if (node.type === "FunctionDeclaration") list(node.id.name, node, exported.get(node) ?? node);
  }
  for (const whole of tree.body) {
    const node = whole.declaration ?? whole;
    if (node.type === "ClassDeclaration") ofClass(node);
    if (node.type !== "VariableDeclaration") continue;
    for (const { id, init } of node.declarations) {
      if (init && FUNCTIONS.includes(init.type)) list(id.name, init, whole);
    }
  }
  return listed;
}

console.log(JSON.stringify(process.argv.slice(2).flatMap(functionsOf)));
