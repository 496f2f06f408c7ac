// A button on each block of code that copies it.
for (const block of document.querySelectorAll("div.highlight pre")) {
  const lines = block.textContent;
  const button = document.createElement("button");
  button.className = "copy";
  button.textContent = "copy";
  button.addEventListener("click", async () => {
    await navigator.clipboard.writeText(lines);
    button.textContent = "copied";
    setTimeout(() => (button.textContent = "copy"), 1500);
  });
  block.parentElement.append(button);
}
