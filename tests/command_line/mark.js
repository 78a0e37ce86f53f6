"use strict";

// Adds links at the top and bottom of every figure: a PDF states their pages uncompressed.
window.addEventListener("load", () => {
  [...document.querySelectorAll("figure, .figure, .card")].forEach((figure, number) => {
    figure.style.position = "relative";
    for (const edge of ["top", "bottom"]) {
      const mark = document.createElement("a");
      mark.href = "https://mark.invalid/" + number + "-" + edge;
      mark.style.cssText = "position: absolute; left: 0; width: 3px; height: 3px; display: block; overflow: hidden; " + edge + ": 0";
      mark.textContent = ".";
      figure.append(mark);
    }
  });
});
