"use strict";
// Formulas are typeset when the page is there, by what lies beside it: nothing is fetched from elsewhere.
document.addEventListener("DOMContentLoaded", () => {
  for (const formula of document.querySelectorAll(".arithmatex")) {
    renderMathInElement(formula, { delimiters: [{ left: "\\[", right: "\\]", display: true }] });
  }
});
