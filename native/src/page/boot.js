// Opens a page that is one file. Its other files lie compressed in the blocks of the document; a module gets an
// address of its own (`blob:`) when it is first asked for, with the addresses of those that it imports in place of
// their names. From disk a browser does not share such addresses with workers: each runs this script again, is
// told the files by its first message, and makes addresses itself.
{
  const LACK =
    "This file was made without the modules that train, so nothing can be computed here; recorded runs still play. " +
    "`cargo xtask web` builds the modules, `mcvl page --modules www/pkg` writes a page with them.";
  const TYPES = { js: "text/javascript", json: "application/json", wasm: "application/wasm" };
  /** Stands for `files.js` of a page that has its files beside it. */
  const FILES = "export const { lack, load, get, hire, keepOffline } = globalThis.files;";

  /** What lies in a compressed file. */
  const content = (name, packed) => {
    const type = TYPES[name.split(".").at(-1)];
    return new Response(packed.stream().pipeThrough(new DecompressionStream("gzip")), { headers: { "content-type": type } });
  };

  /** Makes the files known to the module `files.js`; gives the function that loads a module. */
  const open = (files) => {
    const { script, modules, others } = files;
    const addresses = new Map();
    const made = (text) => URL.createObjectURL(new Blob([text], { type: TYPES.js }));
    const address = (name) => {
      if (!addresses.has(name)) {
        const own = (quoted, other) => (other in modules ? `"${address(other)}"` : quoted);
        addresses.set(name, made(modules[name].replace(/"\.\/([\w/]+\.js)"/g, own)));
      }
      return addresses.get(name);
    };
    const load = (name) => import(address(name));
    const get = async (name) => {
      if (!(name in others)) throw new Error("this page is one file and does not have it");
      return content(name, others[name]);
    };
    const hire = (name) => {
      const worker = new Worker(made(script));
      worker.postMessage({ files, name });
      return worker;
    };
    const lack = ["scalar", "simd"].every((module) => `pkg/${module}.js` in modules) ? "" : LACK;
    // There is nothing to keep: whoever has the file has the page.
    globalThis.files = { lack, load, get, hire, keepOffline: () => {} };
    return load;
  };

  /**
   * In a frame that came with another file no link leads back to the page, other recordings are not there, and without
   * modules there is no token.
   */
  const hideLinks = ({ lack }) => {
    if (location.protocol !== "about:") return;
    for (const id of ["recorded", lack ? "share" : "links"]) document.getElementById(id).style.display = "none";
  };

  /** Resolves when the page comes into view: in a closed part of another document it does not, and costs nothing. */
  const inView = () =>
    new Promise((resolve) => {
      const observer = new IntersectionObserver((entries) => {
        if (!entries.some((entry) => entry.isIntersecting)) return;
        observer.disconnect();
        resolve();
      });
      observer.observe(document.documentElement);
    });

  /** The files in the document, which are not needed there any longer. */
  const unpack = async () => {
    const [modules, others] = [{ "files.js": FILES }, {}];
    const script = document.currentScript.textContent;
    if (globalThis.top !== globalThis) await inView();
    const blocks = [...document.querySelectorAll("script[data-file]")].map(async (block) => {
      const name = block.dataset.file;
      const packed = new Blob([Uint8Array.from(atob(block.textContent), (character) => character.charCodeAt(0))]);
      block.remove();
      if (name.endsWith(".js")) modules[name] = await content(name, packed).text();
      else others[name] = packed;
    });
    await Promise.all(blocks);
    return { script, modules, others };
  };

  if (globalThis.document) {
    unpack()
      .then((files) => {
        const load = open(files);
        hideLinks(globalThis.files);
        return load("page.js");
      })
      .catch(({ message }) => {
        const place = document.getElementById("error");
        place.textContent = `This browser cannot open a page that is one file: ${message}. A newer one can; so can this one, where mcvl serve serves the page.`;
        place.hidden = false;
      });
  } else {
    const first = ({ data: { files, name } }) => {
      const early = [];
      const keep = (event) => early.push(event);
      addEventListener("message", keep);
      open(files)(name).then(
        () => {
          removeEventListener("message", keep);
          for (const { data, ports } of early) dispatchEvent(new MessageEvent("message", { data, ports }));
        },
        // Thrown where nobody catches it, it reaches whoever hired this worker.
        (error) => setTimeout(() => { throw error; }),
      );
    };
    addEventListener("message", first, { once: true });
  }
}
