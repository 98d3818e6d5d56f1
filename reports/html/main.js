// Start: strips of all frames, the player, and what follows the size of the window.
const strips = !$("lines") ? [] : data.runs.map((_, number) => new Strip(number, (index) => pickFrame(number, index)));

function resized() {
  strips.forEach((strip) => strip.draw());
  if (!scenes.length) return;
  drawErrors($("errors"), footage(), $("only").value, state.at);
  draw();
}

$("lines")?.replaceChildren(...strips.map((strip) => strip.node));
if ($("viewer")) setUp();
resized();
window.addEventListener("resize", resized);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", resized);
document.body.dataset.ready = "true";
