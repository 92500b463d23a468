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
      heading.tabIndex = 0;
      heading.addEventListener("click", () => sort(table, heading));
      heading.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        sort(table, heading);
      });
    }
  }

  // Plots: drawn when they come near the window; until then, and on paper, the static picture shows.
  const settings = {
    responsive: true,
    displaylogo: false,
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  };
  const draw = async (figure) => {
    const live = figure.querySelector(".live");
    const plot = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
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
    const packed = atob(document.getElementById(id).textContent);
    const bytes = Uint8Array.from(packed, (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
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
  if (typeof DecompressionStream !== "undefined") unpack("plotly").then(watch, console.error);
})();
