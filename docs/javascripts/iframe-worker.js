// Browsers start no workers on pages opened as files. There, a hidden frame runs the worker of the search instead.
// `importScripts` is not provided: the search calls it only for languages other than English.

"use strict";

class FrameWorker extends EventTarget {
  constructor(url) {
    super();
    const frame = document.createElement("iframe");
    frame.hidden = true;
    frame.srcdoc = "<!doctype html>"; // has the origin of this page, so that both sides may call each other
    this.scope = new Promise((resolve, reject) => {
      frame.addEventListener("load", () => {
        const scope = frame.contentWindow;
        scope.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
        const script = scope.document.createElement("script");
        script.src = new URL(url, document.baseURI);
        script.addEventListener("load", () => resolve(scope));
        script.addEventListener("error", () => reject(new Error(`cannot load ${script.src}`)));
        scope.document.head.append(script);
      });
    });
    document.body.append(frame);
  }

  postMessage(data) {
    this.scope.then((scope) => scope.dispatchEvent(new MessageEvent("message", { data })));
  }
}

if (location.protocol === "file:") window.Worker = FrameWorker;
