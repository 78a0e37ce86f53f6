"use strict";

// Runs beside an iframe with the page: finds content beyond the screen, except in scrollable elements.
window.addEventListener("load", () => setTimeout(() => {
  const page = document.querySelector("iframe").contentDocument;
  const root = page.documentElement;
  const scrolls = (element) => element && (getComputedStyle(element).overflowX !== "visible" || scrolls(element.parentElement));
  const beyond = [...page.querySelectorAll("body *")].filter((element) => {
    const box = element.getBoundingClientRect();
    return box.width > 0 && box.right > root.clientWidth + 1 && !scrolls(element.parentElement);
  });
  const names = beyond.slice(0, 5).map((element) => element.tagName + "#" + element.id + " to " + Math.round(element.getBoundingClientRect().right));
  const is_there = page.querySelector("h1") !== null;
  document.body.dataset.probe = is_there && root.scrollWidth <= root.clientWidth ? ["fits", ...names].join(" ") : ["is wider: " + root.scrollWidth, ...names].join(" ");
}, 500));
