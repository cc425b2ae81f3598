// A page of file:// may start no Worker: the search's runs in a hidden frame. (The theme would load such a script from
// the network, unless one of this name is given.)
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      this.inner = frame.contentWindow;
      addEventListener("message", ({ source, data }) => {
        if (source === this.inner) this.dispatchEvent(new MessageEvent("message", { data }));
      });
      const send = 'postMessage = (data) => parent.postMessage(data, "*")';
      this.inner.document.write(`<body><script>${send}</script><script src="${url}"></script></body>`);
      this.loaded = new Promise((done) => this.inner.addEventListener("load", done));
      this.inner.document.close();
    }
    postMessage(data) {
      this.loaded.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data })));
    }
  };
}
