// Waits for the samples of both pictures of a live page, and sends what the page says and its films.
(async () => {
  const send = (path, body) => fetch(path, { method: 'POST', body });
  const said = () => document.getElementById('live-message').textContent;
  const isDone = () => ['left', 'right'].every((side) => window.headtail.pictures[side]?.samples === SAMPLES);
  while (!isDone() && (said() === '' || said().startsWith('Compiling'))) await new Promise((done) => setTimeout(done, 200));
  if (isDone()) for (const side of ['left', 'right']) await send('/' + side, await window.headtail.read(side));
  await send('/done', said());
})();
