"use strict";
(() => {
  // Tables: a click on a heading sorts by it, another one the other way round.
  const value = (cell) => {
    const text = cell.dataset.value ?? cell.textContent.trim();
    const number = Number.parseFloat(text);
    return Number.isNaN(number) ? (cell.dataset.value === undefined ? text : null) : number;
  };
  const compare = (a, b) => {
    if (a === null || b === null) return (a === null) - (b === null);
    return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b));
  };
  const sort = (table, heading) => {
    const headings = [...heading.parentElement.cells];
    const column = headings.indexOf(heading);
    const up = heading.getAttribute("aria-sort") !== "ascending";
    for (const other of headings) other.setAttribute("aria-sort", "none");
    heading.setAttribute("aria-sort", up ? "ascending" : "descending");
    const body = table.tBodies[0];
    const keyed = [...body.rows].map((row) => [value(row.cells[column]), row]);
    keyed.sort(([a], [b]) => (a === null || b === null || up ? compare(a, b) : compare(b, a)));
    body.append(...keyed.map(([, row]) => row));
  };
  for (const table of document.querySelectorAll("table.sortable")) {
    for (const heading of table.tHead.rows[0].cells) {
      heading.setAttribute("aria-sort", "none");
      const button = document.createElement("button");
      button.type = "button";
      button.append(...heading.childNodes);
      button.addEventListener("click", () => sort(table, heading));
      heading.append(button);
    }
  }

  // Rows of a table: those that hold what is typed and are of the kind chosen.
  for (const tools of document.querySelectorAll("[data-filter]")) {
    const rows = [...document.getElementById(tools.dataset.filter).tBodies[0].rows];
    const [typed, kind, said] = ["input", "select", "output"].map((name) => tools.querySelector(name));
    const apply = () => {
      const text = typed.value.trim().toLowerCase();
      for (const row of rows) {
        const named = [0, 3].some((k) => row.cells[k].textContent.toLowerCase().includes(text));
        row.hidden = !named || !row.dataset.kind.includes(kind.value);
      }
      said.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
    };
    for (const each of [typed, kind]) each.addEventListener("input", apply);
    apply();
  }

  // Cases of bounds side by side: those chosen, and how far each moves the parameters.
  const figures = (cell) => [Number.parseFloat(cell.dataset.value), Number.parseFloat(cell.dataset.error)];
  const signed = (x) => `${x < 0 ? "−" : "+"}${Math.abs(x).toFixed(1)}σ`;
  for (const explorer of document.querySelectorAll(".explorer")) {
    const boxes = [...explorer.querySelectorAll("input[type=checkbox]")];
    const [against, least] = explorer.querySelectorAll("select");
    const [said, table] = [explorer.querySelector("output"), explorer.querySelector("table")];
    // How far each cell of a row is from the case compared with, in its standard errors.
    const moved = (row) => {
      const [from, error] = figures(row.cells[1 + Number(against.value)]);
      let largest = 0;
      boxes.forEach((box, k) => {
        const cell = row.cells[1 + k];
        const [value, own] = figures(cell);
        const sigma = error > 0 ? error : own;
        const move = value === from ? 0 : sigma > 0 ? (value - from) / sigma : Number.NaN;
        cell.querySelector("small").textContent = move ? ` ${signed(move)}` : "";
        if (box.checked) largest = Math.max(largest, Math.abs(move) || 0);
      });
      row.cells[row.cells.length - 1].dataset.value = String(largest);
      row.cells[row.cells.length - 1].textContent = largest ? `${largest.toFixed(1)}σ` : "";
      return largest;
    };
    const show = () => {
      const chosen = boxes.map((box) => box.checked);
      for (const row of explorer.querySelectorAll("[data-case]")) row.hidden = !chosen[row.dataset.case];
      const rows = [...table.tBodies[0].rows];
      const far = new Map(rows.map((row) => [row, moved(row)]));
      for (const row of rows) row.hidden = far.get(row) < Number(least.value);
      table.tBodies[0].append(...rows.sort((a, b) => far.get(b) - far.get(a)));
      said.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} parameters`;
    };
    for (const each of [...boxes, against, least]) each.addEventListener("input", show);
    show();
  }

  // Plots: drawn when they come near the window; until then, and on paper, the static picture shows.
  const settings = {
    responsive: true,
    displaylogo: false,
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  };
  const text = async (packed) => {
    const bytes = Uint8Array.from(atob(packed.textContent), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };
  // Numbers come as second differences of whole steps, null where there is none.
  const numbers = ({ step, log, turns }) => {
    let [whole, slope] = [0, 0];
    return turns.map((turn) => {
      if (turn === null) return null;
      slope += turn;
      whole += slope;
      return log ? 10 ** (step * whole) : step * whole;
    });
  };
  const draw = async (figure) => {
    const live = figure.querySelector(".live");
    const plot = JSON.parse(await text(figure.querySelector("script")));
    for (const trace of plot.data) {
      for (const axis of ["x", "y"]) if (trace[axis]?.turns) trace[axis] = numbers(trace[axis]);
    }
    figure.classList.add("drawn");
    try {
      await Plotly.newPlot(live, plot.data, plot.layout, settings);
      figure.dataset.state = "drawn";
    } catch (error) {
      figure.classList.remove("drawn");
      console.error(error);
    }
  };
  const unpack = async (id) => {
    const script = document.createElement("script");
    script.textContent = await text(document.getElementById(id));
    document.head.append(script);
  };
  const watch = () => {
    const near = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        near.unobserve(entry.target);
        draw(entry.target);
      }
    }, { rootMargin: "800px" });
    for (const figure of document.querySelectorAll("figure.interactive")) near.observe(figure);
  };
  // A browser that cannot unpack the library keeps the static pictures.
  // On a narrow screen their text stays readable, which that of a squeezed plot does not.
  const wide = window.matchMedia("(min-width: 44rem)").matches;
  if (wide && typeof DecompressionStream !== "undefined") unpack("plotly").then(watch, console.error);
})();
