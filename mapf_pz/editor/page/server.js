// The server of `mapf-pz edit`, which reads and writes files and runs planners and policies.

class ServerError extends Error {
  constructor(message, answer) { super(message); this.answer = answer; }
}

class Server {
  constructor(token) { this.token = token; }

  async call(name, values = {}) {
    const headers = { "Content-Type": "application/json", "X-Token": this.token };
    let response;
    try {
      response = await fetch(`/api/${name}`, { method: "POST", headers, body: JSON.stringify(values) });
    } catch (error) {
      throw new ServerError(`no answer: is 'mapf-pz edit' still running? (${error.message})`, {});
    }
    const answer = await response.json();
    if (!response.ok) throw new ServerError(answer.error, answer);
    return answer;
  }

  // Saves a file; asks before one is replaced, and returns whether it was saved.
  async save(path, text) {
    try {
      await this.call("save", { path, text, overwrite: false });
    } catch (error) {
      if (!error.answer?.exists) throw error;
      if (!confirm(`${path} exists. Replace it?`)) return false;
      await this.call("save", { path, text, overwrite: true });
    }
    return true;
  }
}
