// What the terminal shows: one line an event, and a table at the end. Colours only on a terminal.

const COLOURS = { robot: 36, measured: 32, note: 33, wait: 2 };
const WIDTH = 9;

export function line(kind, text) {
  const mark = kind.padEnd(WIDTH);
  console.log(process.stdout.isTTY ? `\x1b[${COLOURS[kind]}m${mark}\x1b[0m ${text}` : `${mark} ${text}`);
}

export function table(title, rows) {
  const widths = rows[0].map((_, column) => Math.max(...rows.map((row) => row[column].length)));
  console.log(`\n${title}`);
  for (const row of rows) console.log(`  ${row.map((cell, i) => cell.padEnd(widths[i])).join("  ").trimEnd()}`);
}
