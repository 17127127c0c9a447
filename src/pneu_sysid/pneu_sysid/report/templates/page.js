// SPDX-License-Identifier: Apache-2.0
// Starts the time plot and ties the rest of the page to it.
{
  const root = document.documentElement;
  const figure = document.getElementById("viewer");
  if (figure) {
    const packed = JSON.parse(document.getElementById("viewer-data").textContent);
    const viewer = createViewer(figure, packed);

    // Worst-stretch buttons and cells of the time map carry the stretch they stand for.
    document.addEventListener("click", (event) => {
      const span = event.target.closest("[data-span]")?.dataset.span;
      if (!span) return;
      if (span === "all") {
        viewer.showAll();
        return;
      }
      const [from, to] = span.split(",").map(Number);
      const margin = 0.5 * (to - from);
      viewer.show(from - margin, to + margin);
      figure.scrollIntoView({ block: "nearest" });
    });
    addEventListener("resize", viewer.draw);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", viewer.draw);
    addEventListener("beforeprint", () => {
      root.classList.add("printing");
      viewer.draw();
    });
    addEventListener("afterprint", () => {
      root.classList.remove("printing");
      viewer.draw();
    });
  }
  root.dataset.ready = "yes";
}
